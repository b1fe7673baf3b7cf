//! The picture of a scan: it is well-formed SVG, and shows the measured values.

use urg_emulator::Emulator;

use super::program::run;
use super::web::on_tcp;

struct Element {
    name: String,
    attributes: Vec<(String, String)>,
    /// Text right after the element's tag.
    text: String,
}

impl Element {
    fn get(&self, name: &str) -> Option<&str> {
        let mut attributes = self.attributes.iter();
        attributes.find(|(other, _)| other == name).map(|(_, value)| value.as_str())
    }

    fn number(&self, name: &str) -> f64 {
        self.get(name).unwrap().parse().unwrap()
    }
}

/// Parses the elements of an XML document. Panics if it is not well-formed.
fn elements(xml: &str) -> Vec<Element> {
    let xml =
        xml.strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>").expect("a declaration");
    assert!(xml.chars().all(|c| c == '\n' || !c.is_control()), "control characters");
    let (mut open, mut found) = (Vec::new(), Vec::new());
    let mut parts = xml.split('<');
    assert_eq!(parts.next().map(str::trim), Some(""));
    for part in parts {
        let (tag, text) = part.split_once('>').expect("tags end");
        let text = plain(text);
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "tags are closed in order");
            assert!(!open.is_empty() || text.trim().is_empty(), "text behind the end");
            continue;
        }
        let closed = tag.ends_with('/');
        let tag = tag.trim_end_matches('/');
        let (name, mut rest) = tag.split_once(' ').unwrap_or((tag, ""));
        let mut attributes = Vec::new();
        while let Some((name, value)) = rest.trim_start().split_once("=\"") {
            let (value, after) = value.split_once('"').expect("values are quoted");
            attributes.push((name.to_owned(), plain(value)));
            rest = after;
        }
        assert_eq!(rest.trim(), "", "in <{tag}>");
        if !closed {
            open.push(name.to_owned());
        }
        found.push(Element { name: name.to_owned(), attributes, text });
    }
    assert_eq!(open, [""; 0], "all is closed");
    found
}

/// Replaces entities. A single & is an error.
fn plain(text: &str) -> String {
    let mut parts = text.split('&');
    let mut plain = parts.next().unwrap().to_owned();
    for part in parts {
        let (entity, rest) = part.split_once(';').expect("& begins an entity");
        plain.push_str(match entity {
            "amp" => "&",
            "lt" => "<",
            "gt" => ">",
            "quot" => "\"",
            _ => panic!("&{entity};"),
        });
        plain.push_str(rest);
    }
    plain
}

fn texts(svg: &str) -> Vec<String> {
    let texts = elements(svg).into_iter().filter(|element| element.name == "text");
    texts.map(|element| element.text).collect()
}

#[test]
fn a_picture_is_well_formed_and_labelled() {
    let svg = run("scan emulated --format svg", 0).stdout;
    let texts = texts(&svg);
    for text in ["SOKUIKI Sensor URG-04LX H0713090", "1 m", "4 m", "0°", "90°", "-90°", "30°"] {
        assert!(texts.iter().any(|other| other == text), "{text} is not in {texts:?}");
    }
    let starting = |text: &str| texts.iter().any(|other| other.contains(text));
    assert!(starting(" UTC, steps 44 to 725 (-119.5° to 119.9°)"), "{texts:?}");
    assert!(starting("of 682 points have a distance, nearest "), "{texts:?}");
    assert!(starting("possibly beyond the range (code "), "{texts:?}");
}

#[test]
fn each_distance_is_a_point_where_it_was_measured() {
    // The same seed makes the same room.
    let svg = run("scan emulated --format svg --window full --cluster 3", 0).stdout;
    let elements = elements(&svg);
    let circles: Vec<_> = elements
        .iter()
        .filter(|element| element.name == "circle" && element.get("r") == Some("0.45"))
        .map(|element| (element.number("cx"), element.number("cy")))
        .collect();
    let summary = texts(&svg).into_iter().find(|text| text.contains("have a distance")).unwrap();
    let count: usize = summary.split(' ').next().unwrap().parse().unwrap();
    assert_eq!(circles.len(), count);
    // The nearest point is as far from the sensor as the legend states. The full sector of
    // 4.2 m is 152 mm wide.
    let sensor = elements.iter().find(|element| element.get("class") == Some("sensor")).unwrap();
    let place = sensor.get("transform").unwrap();
    let place = place.trim_start_matches("translate(").trim_end_matches(')');
    let (x, y) = place.split_once(' ').unwrap();
    let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
    let metre = 152.0 / 8.4;
    let nearest = circles
        .iter()
        .map(|(cx, cy)| (cx - x).hypot(cy - y) / metre)
        .min_by(f64::total_cmp)
        .unwrap();
    let (_, stated) = summary.split_once("nearest ").unwrap();
    let stated: f64 = stated.split(' ').next().unwrap().parse().unwrap();
    assert!((nearest - stated).abs() < 0.002, "{nearest} {stated}");
    // It has a ring and its distance.
    let ring = elements.iter().find(|element| element.get("class") == Some("nearest")).unwrap();
    let away = (ring.number("cx") - x).hypot(ring.number("cy") - y) / metre;
    assert!((away - nearest).abs() < 0.002, "{away} {nearest}");
    assert!(texts(&svg).contains(&format!("{stated:.2} m")));
}

#[test]
fn every_window_makes_a_picture() {
    for window in ["--window 384..384", "--from 60 --to 100", "--window 0..43", "--cluster 99"] {
        let svg = run(&format!("scan emulated --format svg {window}"), 0).stdout;
        elements(&svg);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{window}");
    }
}

#[test]
fn text_from_a_sensor_stays_text_in_a_picture() {
    let emulator = Emulator::builder().serial_number("<a&b>\"'\x1b]]>").build();
    let (_runtime, port) = on_tcp(emulator);
    let svg = run(&format!("scan {port} --format svg"), 0).stdout;
    let texts = texts(&svg);
    assert_eq!(texts[0], r#"SOKUIKI Sensor URG-04LX <a&b>"'\x1b]]>"#);
}
