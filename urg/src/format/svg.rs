//! Polar plot of a scan in SVG, for print. Units are millimetres. The picture is 180 mm
//! wide, so that it fits on an A4 page.

use std::fmt::{self, Write};

use tokio_scip::{Point, Scan, Version};

use super::time;
use crate::plot::colours::{self, DISTANCES, INTENSITIES};
use crate::plot::missing::MissingKind;
use crate::plot::summary::ScanSummary;
use crate::plot::{self, Anchor, Place, Sector};

const WIDTH: f64 = 180.0;
const MARGIN: f64 = 14.0;
const HEADER: f64 = 21.0;
/// Maximum height of a plot, whatever its sector.
const MAX_HEIGHT: f64 = 170.0;
const LINE: f64 = 4.6;
/// Spacing of the tracks outside the sector, which show missing distances.
const TRACK: f64 = 1.7;
/// Must equal the stroke width of `.track` in [`STYLE`].
const TRACK_WIDTH: f64 = 1.1;
/// Longer texts from the sensor are cut.
const MAX_TEXT_CHARS: usize = 90;

const STYLE: &str = "\
text { font-family: Helvetica, Arial, 'DejaVu Sans', sans-serif; font-size: 3.1px; fill: #222 }
.title { font-size: 5px; font-weight: bold }
.small { font-size: 2.7px; fill: #555 }
.sector { fill: #f6f7f9; stroke: #8a929c; stroke-width: 0.25 }
.ring { fill: none; stroke: #aab2bb; stroke-width: 0.2 }
.seen { fill: #e6ebf1; stroke: none }
.track { fill: none; stroke-width: 1.1 }
.sensor { fill: #222 }
.nearest { fill: none; stroke: #222; stroke-width: 0.3 }";

/// Draws the picture, with the name of the sensor.
pub(crate) fn svg(scan: &Scan, version: &Version) -> String {
    let sector = Sector::from_window(scan.window(), scan.geometry());
    let paper = Paper::fitted_to(sector, plot::reach(scan));
    let mut text = String::with_capacity(64 * 1024);
    // Writing to a `String` is infallible.
    let _ = paper.picture(&mut text, scan, version);
    text
}

struct Paper {
    sector: Sector,
    /// Radius of the sector in metres.
    reach: f64,
    /// Millimetres of paper per metre.
    scale: f64,
    /// Place of the sensor.
    x: f64,
    y: f64,
    /// Lower end of the plot.
    bottom: f64,
}

impl Paper {
    fn fitted_to(sector: Sector, reach: f64) -> Self {
        let extent = sector.extent();
        let (width, height) = (extent.left + extent.right, extent.ahead + extent.behind);
        let room = WIDTH - 2.0 * MARGIN;
        let scale = (room / width).min(MAX_HEIGHT / height) / reach;
        let radius = scale * reach;
        let top = HEADER + MARGIN;
        Self {
            sector,
            reach,
            scale,
            // Centre a plot that is narrower than the paper.
            x: (WIDTH - radius * width) / 2.0 + radius * extent.left,
            y: top + radius * extent.ahead,
            bottom: top + radius * height + MARGIN,
        }
    }

    fn picture(&self, out: &mut String, scan: &Scan, version: &Version) -> fmt::Result {
        let height = self.bottom + 7.0 * LINE;
        writeln!(out, r#"<?xml version="1.0" encoding="UTF-8"?>"#)?;
        write!(out, r#"<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}mm" "#)?;
        writeln!(out, r#"height="{height:.1}mm" viewBox="0 0 {WIDTH} {height:.1}">"#)?;
        let who = format!("{} {}", version.product, version.serial_number);
        let when = time::utc(scan.times().stamp);
        writeln!(out, "<title>Scan of {}, {when}</title>", xml(&who))?;
        writeln!(out, "<style>\n{STYLE}")?;
        for kind in MissingKind::ALL {
            writeln!(out, ".{} {{ stroke: {} }}", kind.name(), kind.colours().on_light)?;
        }
        let colours = if scan.intensities().is_some() { INTENSITIES } else { DISTANCES };
        for (band, colours) in colours.iter().enumerate() {
            writeln!(out, ".d{band} {{ fill: {} }}", colours.on_light)?;
        }
        writeln!(out, "</style>")?;
        writeln!(out, r##"<rect width="100%" height="100%" fill="#fff"/>"##)?;
        self.header(out, &who, &when, scan, version)?;
        self.seen(out, scan)?;
        self.grid(out)?;
        self.points(out, scan)?;
        self.missing(out, scan)?;
        self.legend(out, scan)?;
        writeln!(out, "</svg>")
    }

    fn header(
        &self,
        out: &mut String,
        who: &str,
        when: &str,
        scan: &Scan,
        version: &Version,
    ) -> fmt::Result {
        let window = scan.window();
        let cluster = match window.cluster_count() {
            1 => String::new(),
            count => format!(", {count} steps a point"),
        };
        let what = format!(
            "{when}, steps {} to {} ({:.1}° to {:.1}°){cluster}",
            window.start(),
            window.end(),
            scan.geometry().degrees(window.start()),
            scan.geometry().degrees(window.end())
        );
        let firmware = format!("firmware {}", version.firmware);
        for (class, y, text) in
            [("title", 8.0, who), ("what", 14.0, &what), ("small", 18.5, &firmware)]
        {
            let text: String = text.chars().take(MAX_TEXT_CHARS).collect();
            writeln!(out, r#"<text class="{class}" x="5" y="{y}">{}</text>"#, xml(&text))?;
        }
        Ok(())
    }

    fn grid(&self, out: &mut String) -> fmt::Result {
        let (sector, radius) = (self.sector, self.scale * self.reach);
        let (x, y) = (self.x, self.y);
        for ring in plot::rings(self.reach) {
            writeln!(out, r#"<path class="ring" d="M{}"/>"#, self.arc(sector, ring))?;
        }
        for degrees in sector.directions() {
            let angle = f64::from(degrees).to_radians();
            let (to_x, to_y) = self.at(plot::place(self.reach, angle));
            writeln!(out, r#"<path class="ring" d="M{x:.2} {y:.2}L{to_x:.2} {to_y:.2}"/>"#)?;
            // Outside the tracks.
            let (x, y) = self.at(plot::place((radius + 10.5) / self.scale, angle));
            label(out, "what", Anchor::Middle, (x, y), &format!("{degrees}°"))?;
        }
        for ring in plot::rings(self.reach) {
            let (place, anchor) = sector.beside(ring, 2.6 / self.scale);
            label(out, "small", anchor, self.at(place), &format!("{ring} m"))?;
        }
        Ok(())
    }

    /// Draws the sector, and in it the free space between the sensor and the points.
    fn seen(&self, out: &mut String, scan: &Scan) -> fmt::Result {
        let (x, y, rim) = (self.x, self.y, self.arc(self.sector, self.reach));
        writeln!(out, r#"<path class="sector" d="M{x:.2} {y:.2}L{rim}Z"/>"#)?;
        let half = f64::from(scan.angle_increment()) / 2.0;
        let (mut seen, mut open) = (String::new(), false);
        for ray in scan.rays() {
            let Some(millimetres) = ray.measurement.distance() else {
                open = false;
                continue;
            };
            if !std::mem::replace(&mut open, true) {
                write!(seen, "M{x:.2} {y:.2}")?;
            }
            let (range, angle) = (f64::from(millimetres) / 1000.0, f64::from(ray.angle));
            for angle in [angle - half, angle + half] {
                let (x, y) = self.at(plot::place(range, angle));
                write!(seen, "L{x:.2} {y:.2}")?;
            }
        }
        writeln!(out, r#"<path class="seen" d="{seen}"/>"#)
    }

    /// Draws the points, the sensor, and a ring around the nearest point.
    fn points(&self, out: &mut String, scan: &Scan) -> fmt::Result {
        let band = |range: f32| colours::band(range.into(), colours::width(self.reach));
        for (point, shade) in plot::points(scan) {
            let (x, y) = self.at(plot::place(point.range.into(), point.angle.into()));
            let band = shade.unwrap_or_else(|| band(point.range));
            writeln!(out, r#"<circle class="d{band}" cx="{x:.2}" cy="{y:.2}" r="0.45"/>"#)?;
        }
        let place = format!("translate({:.2} {:.2})", self.x, self.y);
        writeln!(out, r#"<path class="sensor" transform="{place}" d="M0 -1.9L1.4 1.4H-1.4Z"/>"#)?;
        let Some(nearest) = scan.nearest() else { return Ok(()) };
        let (x, y) = self.at(plot::place(nearest.range.into(), nearest.angle.into()));
        writeln!(out, r#"<circle class="nearest" cx="{x:.2}" cy="{y:.2}" r="1.8"/>"#)?;
        // On the side away from the sensor.
        let (anchor, aside) = if x < self.x { (Anchor::End, -2.6) } else { (Anchor::Start, 2.6) };
        label(out, "what", anchor, (x + aside, y), &format!("{:.2} m", nearest.range))
    }

    /// Draws one track outside the sector for each kind of missing distance, so that the
    /// kinds differ even without colours.
    fn missing(&self, out: &mut String, scan: &Scan) -> fmt::Result {
        // A single direction is at least as wide as its track is high.
        let least = TRACK_WIDTH / 2.0 / (self.reach * self.scale);
        let half = (f64::from(scan.angle_increment()) / 2.0).max(least);
        for (track, kind) in (1..).zip(MissingKind::ALL.into_iter().rev()) {
            let radius = self.reach + f64::from(track) * TRACK / self.scale;
            let mut arcs = String::new();
            let mut run: Option<Sector> = None;
            let directions = scan.rays().map(|ray| (f64::from(ray.angle), Some(ray.measurement)));
            // An extra item ends the last run.
            for (angle, measurement) in directions.chain([(0.0, None)]) {
                if measurement.and_then(MissingKind::from_measurement) == Some(kind) {
                    run.get_or_insert(Sector { from: angle - half, to: angle }).to = angle + half;
                } else if let Some(run) = run.take() {
                    write!(arcs, "M{}", self.arc(run, radius))?;
                }
            }
            if !arcs.is_empty() {
                writeln!(out, r#"<path class="track {}" d="{arcs}"/>"#, kind.name())?;
            }
        }
        Ok(())
    }

    fn legend(&self, out: &mut String, scan: &Scan) -> fmt::Result {
        let mut y = self.bottom + LINE;
        let mut row = |out: &mut String, mark: &str, text: &str| {
            writeln!(out, r#"<g transform="translate(5 {y:.2})">{mark}</g>"#)?;
            label(out, "what", Anchor::Start, (12.0, y), text)?;
            y += LINE;
            Ok(())
        };
        let summary = ScanSummary::from_scan(scan);
        let mut text = format!("{} of {} points have a distance", summary.distances, scan.len());
        if let (Some(near), Some(far)) = (summary.nearest, summary.farthest) {
            let _ = write!(text, ", nearest {}, farthest {}", place_name(near), place_name(far));
        }
        let bars = (0..DISTANCES.len()).map(|band| {
            format!(r#"<path class="d{band}" d="M{} -0.55h0.5v1.1h-0.5Z"/>"#, band as f64 * 0.5)
        });
        row(out, &bars.collect::<String>(), &text)?;
        for (kind, track) in MissingKind::ALL.into_iter().zip(["outer", "middle", "inner"]) {
            let mut text = format!("{} {}: {}", summary.count(kind), kind.name(), kind.meaning());
            for (n, (measurement, points)) in summary.missing_of(kind).enumerate() {
                let before = if n == 0 { " (" } else { ", " };
                let _ = write!(text, "{before}code {}: {points}", measurement.value());
            }
            if summary.count(kind) > 0 {
                let _ = write!(text, "), {track} track");
            }
            row(out, &format!(r#"<path class="track {}" d="M0 0H4"/>"#, kind.name()), &text)?;
        }
        y += 1.0;
        let [weak, strong] = colours::SCALE;
        let colours = match scan.intensities() {
            Some(_) => format!("Shades of intensity: {weak} to {strong}, each twice the last."),
            None => format!("A colour for each {} m.", colours::width(self.reach)),
        };
        let about = format!(
            "Seen from above, front up; angles counter-clockwise. {colours} urg {}",
            env!("CARGO_PKG_VERSION"),
        );
        label(out, "small", Anchor::Start, (5.0, y), &about)
    }

    fn at(&self, place: Place) -> (f64, f64) {
        (self.x + place.right * self.scale, self.y - place.ahead * self.scale)
    }

    /// Formats a path along an arc, without its first `M`.
    fn arc(&self, sector: Sector, range: f64) -> String {
        let (x, y) = self.at(plot::place(range, sector.from));
        let (to_x, to_y) = self.at(plot::place(range, sector.to));
        let radius = range * self.scale;
        let large = u8::from(sector.to - sector.from > std::f64::consts::PI);
        format!("{x:.2} {y:.2}A{radius:.2} {radius:.2} 0 {large} 0 {to_x:.2} {to_y:.2}")
    }
}

/// Writes text, vertically centred on a place.
fn label(
    out: &mut String,
    class: &str,
    anchor: Anchor,
    (x, y): (f64, f64),
    text: &str,
) -> fmt::Result {
    let y = y + 1.1;
    let anchor = match anchor {
        Anchor::Start => "start",
        Anchor::Middle => "middle",
        Anchor::End => "end",
    };
    writeln!(
        out,
        r#"<text class="{class}" text-anchor="{anchor}" x="{x:.2}" y="{y:.2}">{}</text>"#,
        xml(text)
    )
}

fn place_name(point: Point) -> String {
    format!("{:.3} m at {:.1}°", point.range, point.angle.to_degrees())
}

/// Escapes text for XML. Drops control characters, which XML does not allow.
fn xml(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c if c.is_control() => {}
            c => escaped.push(c),
        }
    }
    escaped
}
