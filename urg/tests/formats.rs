//! Standard output, with the emulated sensor inside the program.

use serde_json::Value;

use super::program::run;

/// Parses the scans of NDJSON.
pub(crate) fn scans(ndjson: &str) -> Vec<Value> {
    ndjson.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

pub(crate) fn values(scan: &Value) -> Vec<u64> {
    scan["values"].as_array().unwrap().iter().map(|value| value.as_u64().unwrap()).collect()
}

/// Returns the next event of this name. Only scans and errors may precede it.
pub(crate) fn event(name: &str, mut line: impl FnMut() -> String) -> Value {
    loop {
        let line: Value = serde_json::from_str(&line()).unwrap();
        if line["event"] == name {
            return line;
        }
        assert!(line["event"].is_null() || line["event"] == "error", "{line}");
    }
}

/// Asserts that all fields of a scan fit together as documented.
pub(crate) fn check(scan: &Value) {
    let field = |name: &str| scan[name].as_f64().unwrap_or_else(|| panic!("{name} in {scan}"));
    let mut names: Vec<_> = scan.as_object().unwrap().keys().map(String::as_str).collect();
    names.sort_unstable();
    assert_eq!(
        names,
        [
            "angle_increment",
            "angle_min",
            "beyond",
            "cluster",
            "end",
            "first_ray",
            "lateness",
            "range_max",
            "range_min",
            "ranges",
            "reconnects",
            "repeat",
            "scan_time",
            "sequence",
            "stamp",
            "stamp_quality",
            "start",
            "values"
        ]
    );
    let (start, end, cluster) = (field("start"), field("end"), field("cluster"));
    let points = ((end - start + 1.0) / cluster).ceil();
    let step = std::f64::consts::TAU / 1024.0;
    let first = start + (cluster - 1.0) / 2.0;
    assert!((field("angle_min") - (first - 384.0) * step).abs() < 1e-6);
    assert!((field("angle_increment") - cluster * step).abs() < 1e-6);
    assert!(field("stamp") > 1.7e9);
    // The reply begins when the revolution ends, at the rear.
    let turned = (384.0 - first) * step + std::f64::consts::PI;
    let lateness = scan["lateness"].as_f64();
    let before = field("scan_time") * turned / std::f64::consts::TAU + lateness.unwrap_or(0.0);
    let since_first_ray = field("stamp") - field("first_ray");
    let quality = if lateness.is_some() { "motor" } else { "arrival" };
    // After a reply that came soon after another one, the first ray follows the last one of the
    // scan before.
    let is_postponed = quality == "arrival" && since_first_ray < before;
    assert!(is_postponed || (since_first_ray - before).abs() < 1e-5, "{scan}");
    assert_eq!(scan["stamp_quality"], quality);
    let values = values(scan);
    let ranges = scan["ranges"].as_array().unwrap();
    assert_eq!((values.len() as f64, ranges.len() as f64), (points, points));
    for (value, range) in values.iter().zip(ranges) {
        match value {
            0..=19 | 4095 => assert!(range.is_null()),
            20..=4094 => {
                assert!((range.as_f64().unwrap() - *value as f64 / 1000.0).abs() < 1e-9);
            }
            _ => panic!("{value} does not fit into 12 bits"),
        }
    }
}

#[test]
fn twenty_scans_are_twenty_lines() {
    let output = run("stream emulated --count 20", 0);
    assert_eq!(output.stderr, "");
    let scans = scans(&output.stdout);
    assert_eq!(scans.len(), 20);
    for (number, scan) in scans.iter().enumerate() {
        check(scan);
        assert_eq!(scan["sequence"], number as u64);
        assert_eq!((&scan["start"], &scan["end"]), (&44.into(), &725.into()));
        let distances = values(scan).into_iter().filter(|value| *value >= 20).count();
        assert!(distances > 300, "a room has walls: {distances}");
    }
    let stamps: Vec<_> = scans.iter().map(|scan| scan["stamp"].as_f64().unwrap()).collect();
    assert!(stamps.windows(2).all(|two| two[0] < two[1]), "{stamps:?}");
}

#[test]
fn the_window_can_be_given_in_steps_or_degrees() {
    for (options, window) in [
        ("--window full", (0, 768, 1)),
        ("--window 100..110 --cluster 4", (100, 110, 4)),
        ("--from -90deg --to 90deg", (128, 640, 1)),
        ("--from -12.5deg --to 0", (349, 384, 1)),
        ("--from -45 --to=-44", (256, 258, 1)),
        ("--to 0", (44, 384, 1)),
    ] {
        let output = run(&format!("scan emulated --format json {options}"), 0);
        let scan: Value = serde_json::from_str(&output.stdout).unwrap();
        check(&scan);
        let number = |name: &str| scan[name].as_u64().unwrap();
        assert_eq!((number("start"), number("end"), number("cluster")), window, "{options}");
    }
}

#[test]
fn csv_has_a_row_for_each_point() {
    let output = run("stream emulated --count 3 --format csv --cluster 2", 0);
    let mut lines = output.stdout.lines();
    assert_eq!(lines.next(), Some("sequence,stamp,time,step,angle,range,code"));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3 * 341);
    for (number, row) in rows.iter().enumerate() {
        let [sequence, stamp, time, step, angle, range, code] = row[..] else { panic!("{row:?}") };
        assert_eq!(sequence.parse(), Ok(number / 341));
        let stamp: f64 = stamp.parse().unwrap();
        assert!(stamp > 1.7e9);
        let step: f64 = step.parse().unwrap();
        // The revolution ended when the reply began to arrive, at the rear.
        let before = 0.1 * (1.0 - (128.0 + step + 0.5) / 1024.0);
        assert!((stamp - time.parse::<f64>().unwrap() - before).abs() < 1e-5, "{row:?}");
        assert_eq!(step, 44.0 + 2.0 * (number % 341) as f64);
        let angle: f64 = angle.parse().unwrap();
        assert!((angle - (step + 0.5 - 384.0) * std::f64::consts::TAU / 1024.0).abs() < 1e-6);
        match (range, code) {
            ("", code) => assert!(matches!(code.parse(), Ok(0..=19 | 4095)), "{row:?}"),
            (range, "") => assert!((0.02..=4.094).contains(&range.parse().unwrap()), "{row:?}"),
            _ => panic!("either a range or a code: {row:?}"),
        }
    }
}

#[test]
fn a_scan_can_be_a_table_json_or_csv() {
    let table = run("scan emulated", 0).stdout;
    assert!(table.starts_with("step  direction   distance\n  44  -119.53°"), "{table}");
    assert!(table.contains("SOKUIKI Sensor URG-04LX H0713090: steps 44..=725"), "{table}");
    assert!(table.contains("nearest"), "{table}");
    // Outside the detection window a sensor has only error code 19.
    let outside = run("scan emulated --window 0..9", 0).stdout;
    assert!(outside.contains("- error code 19: Non-Measurable Distance"), "{outside}");
    assert!(outside.contains("0 of 10 points have a distance"), "{outside}");
    assert!(outside.contains("10 x error code 19"), "{outside}");
    assert_eq!(run("scan emulated --format json", 0).stdout.lines().count(), 1);
    assert_eq!(run("scan emulated --format csv", 0).stdout.lines().count(), 1 + 682);
}

#[test]
fn info_shows_the_sensors_identity_as_text_and_json() {
    let text = run("info emulated", 0).stdout;
    assert!(text.contains("serial number  H0713090"), "{text}");
    assert!(text.contains("baud rate      none (USB)"), "{text}");
    assert!(text.contains("600 rpm nominal: 10 revolutions and scans a second"), "{text}");
    let json = run("info emulated --baud 115200 --format json", 0).stdout;
    let info: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(info["port"], "emulated");
    assert_eq!(info["baud_rate"], 115_200);
    assert_eq!(info["version"]["serial_number"], "H0713090");
}

#[test]
fn laser_and_baud_rate_are_set_and_reported_on_standard_error() {
    for (arguments, said) in [
        ("laser emulated off", "urg: emulated: the laser is off\n"),
        ("laser emulated on", "urg: emulated: the laser is on\n"),
        ("baud emulated 115200", "urg: emulated: the sensor is on USB, which has no baud rate\n"),
    ] {
        let output = run(arguments, 0);
        assert_eq!((output.stdout.as_str(), output.stderr.as_str()), ("", said));
    }
}

#[test]
fn a_sensor_is_restarted_in_scip_2() {
    let output = run("reboot emulated --protocol scip2", 0);
    assert_eq!(output.stderr, "urg: emulated: the sensor restarts\n");
    let output = run("reboot emulated", 1);
    let said =
        "urg: emulated: the sensor speaks SCIP 1.1, which cannot restart it: power-cycle it\n";
    assert_eq!(output.stderr, said);
}

#[test]
fn an_impossible_rate_is_reported_with_a_remedy() {
    let output = run("stream emulated --baud 19200 --count 6", 0);
    assert_eq!(scans(&output.stdout).len(), 6);
    assert_eq!(output.stderr.lines().count(), 1, "{}", output.stderr);
    assert!(output.stderr.contains("where 10 Hz was asked for"), "{}", output.stderr);
    assert!(output.stderr.contains(", 250000 baud"), "{}", output.stderr);
}

#[test]
fn csv_has_x_and_y_on_request() {
    let output = run("stream emulated --count 1 --format csv-xy", 0);
    let mut lines = output.stdout.lines();
    assert_eq!(lines.next(), Some("sequence,stamp,time,step,angle,range,code,x,y"));
    let (mut points, mut missing) = (0, 0);
    for line in lines {
        let row: Vec<_> = line.split(',').collect();
        let [_, _, _, _, angle, range, _, x, y] = row[..] else { panic!("{row:?}") };
        if range.is_empty() {
            assert_eq!((x, y), ("", ""));
            missing += 1;
            continue;
        }
        let number = |text: &str| text.parse::<f64>().unwrap();
        let (sin, cos) = number(angle).sin_cos();
        assert!((number(x) - number(range) * cos).abs() < 0.001, "{line}");
        assert!((number(y) - number(range) * sin).abs() < 0.001, "{line}");
        points += 1;
    }
    assert!(points > 300 && points + missing == 682, "{points} and {missing}");
}
