//! What each model measures, and what its values mean. The numbers are those of the protocol texts
//! and of replies of real sensors.

use std::time::Duration;

use tokio_scip::protocol::scip2::{Command, Content, Reply, Request};
use tokio_scip::protocol::{Geometry, Measurement, WindowError};
use tokio_scip::scan::ScanError;
use tokio_scip::{Scan, Window};

/// Parses the reply to `PP` with these values.
fn geometry(model: &str, numbers: [u32; 7]) -> Geometry {
    let keys = ["DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN"];
    let numbers = keys.into_iter().zip(numbers.map(|number| number.to_string()));
    let mut frame = "PP\n00P".to_owned();
    for (key, value) in std::iter::once(("MODL", model.to_owned())).chain(numbers) {
        let line = format!("{key}:{value}");
        let sum = line.bytes().map(u32::from).sum::<u32>() & 0x3f;
        frame += &format!("\n{line};{}", char::from_u32(sum + 0x30).unwrap());
    }
    let request = Request::new(Command::Parameters, None);
    match Reply::parse(&request, frame.as_bytes()).unwrap().content {
        Content::Parameters(parameters) => parameters.geometry(),
        content => panic!("{content:?}"),
    }
}

fn urg() -> Geometry {
    let model = "URG-04LX(Hokuyo Automatic Co.,Ltd.)";
    geometry(model, [20, 5600, 1024, 44, 725, 384, 600])
}

pub(crate) fn ug01() -> Geometry {
    geometry("URG-04LX-UG01(Simple-URG)", [20, 5600, 1024, 44, 725, 384, 600])
}

pub(crate) fn utm() -> Geometry {
    let model = "UTM-30LX(Hokuyo Automatic Co.,Ltd.)";
    geometry(model, [23, 60_000, 1440, 0, 1080, 540, 2400])
}

fn ust() -> Geometry {
    geometry("UST-10LX", [20, 30_000, 1440, 0, 1080, 540, 2400])
}

fn uxm() -> Geometry {
    geometry("UXM-30LX-E", [100, 100_000, 1440, 0, 760, 380, 1200])
}

#[test]
fn each_model_has_the_geometry_that_it_tells() {
    let text = Geometry::URG_04LX;
    for (geometry, steps_per_revolution, steps, distances, revolution, [from, to]) in [
        (text, 1024, 44..=725, 20..=4094, 100, [-119.531_25, 119.882_81]),
        (urg(), 1024, 44..=725, 20..=5600, 100, [-119.531_25, 119.882_81]),
        (ug01(), 1024, 44..=725, 20..=5600, 100, [-119.531_25, 119.882_81]),
        (utm(), 1440, 0..=1080, 23..=60_000, 25, [-135.0, 135.0]),
        (ust(), 1440, 0..=1080, 20..=30_000, 25, [-135.0, 135.0]),
        (uxm(), 1440, 0..=760, 100..=100_000, 50, [-95.0, 95.0]),
    ] {
        assert_eq!(geometry.steps_per_revolution(), steps_per_revolution);
        assert_eq!((geometry.steps(), geometry.distances()), (steps.clone(), distances));
        assert_eq!(geometry.revolution(), Duration::from_millis(revolution));
        assert!((geometry.degrees(*steps.start()) - from).abs() < 1e-4, "{geometry:?}");
        assert!((geometry.degrees(*steps.end()) - to).abs() < 1e-4, "{geometry:?}");
    }
    assert_ne!(urg(), text);
}

/// Values of a model that are no distance: those that stand for an object beyond the range, and all
/// others.
fn check_codes(geometry: Geometry, infinite: &[u32], others: &[u32]) {
    let (least, greatest) = geometry.distances().into_inner();
    for value in (0..70_000).chain(99_990..100_010).chain([(1 << 18) - 1]) {
        let found = geometry.measurement(value);
        assert_eq!(found.value(), value);
        let is_code = infinite.contains(&value) || others.contains(&value);
        let range = found.range();
        match found {
            Measurement::Error(code) => {
                assert!(is_code || value < least, "{geometry:?}: {found:?}");
                assert_eq!(u32::from(code), value);
                assert_eq!(range == f32::INFINITY, infinite.contains(&value), "{found:?}");
                assert_eq!(range.is_nan(), !infinite.contains(&value), "{found:?}");
                let is_small = code.meaning() == "value below the measurable distances";
                assert_eq!(is_small, !is_code, "{found:?}");
            }
            Measurement::Saturated(_) => {
                assert!(value > greatest && !is_code && range == f32::INFINITY, "{found:?}");
            }
            Measurement::Distance(_) => {
                assert!((least..=greatest).contains(&value) && !is_code, "{found:?}");
                assert!((f64::from(range) * 1000.0 - f64::from(value)).abs() < 0.01, "{found:?}");
            }
        }
    }
}

#[test]
fn each_model_has_its_own_codes() {
    let up_to_19: Vec<u32> = (0..20).collect();
    check_codes(Geometry::URG_04LX, &[0, 6, 16], &up_to_19);
    let short_range = |model| geometry(model, [20, 5600, 1024, 44, 725, 384, 600]);
    for geometry in [urg(), ug01(), short_range("UBG-04LX-F01"), short_range("UHG-08LX")] {
        check_codes(geometry, &[0], &up_to_19);
    }
    check_codes(utm(), &[1], &[1, 2, 3, 4, 5]);
    let ethernet = |model| geometry(model, [23, 60_000, 1440, 0, 1080, 540, 2400]);
    for geometry in [ust(), ethernet("UST-20LX"), ethernet("UTM-30LX-EW")] {
        check_codes(geometry, &[65_533], &[65_533]);
    }
    // A distance like any other.
    check_codes(uxm(), &[], &[]);
    for (geometry, value, text) in [
        (Geometry::URG_04LX, 1, "error code 1: Reflected light has low intensity"),
        (urg(), 1, "error code 1: little light returned"),
        (utm(), 1, "error code 1: nothing in range"),
        (utm(), 2, "error code 2: object too near"),
        (utm(), 22, "error code 22: value below the measurable distances"),
        (ust(), 1, "error code 1: value below the measurable distances"),
        (ust(), 65_533, "error code 65533: nothing in range"),
    ] {
        let Measurement::Error(code) = geometry.measurement(value) else { panic!("{value}") };
        assert_eq!(code.to_string(), text);
    }
}

/// Steps of a window on a sensor.
fn resolved(window: Window, geometry: Geometry) -> Result<(u16, u16), ScanError> {
    // The length of a scan is found by trying.
    let build = |points| Scan::builder(window, vec![30; points]).geometry(geometry).build();
    let scan = match build(0) {
        Err(ScanError::Length { expected, .. }) => build(expected)?,
        other => other?,
    };
    assert!(scan.scan_time() == geometry.revolution() && *scan.geometry() == geometry);
    Ok((scan.window().start(), scan.window().end()))
}

#[test]
fn a_window_gets_the_steps_of_the_sensor() {
    let all = Window::DETECTION;
    let degrees = |from, to| Window::degrees(from..=to).unwrap();
    let steps = |first, last| Window::new(first..=last).unwrap();
    for (window, geometry, expected) in [
        (all, ust(), (0, 1080)),
        (all, uxm(), (0, 760)),
        (all, ug01(), (44, 725)),
        (all.with_cluster_count(7).unwrap(), utm(), (0, 1080)),
        // 90 degrees are 256 steps of 1,024, and 360 of 1,440.
        (degrees(-90.0, 90.0), urg(), (128, 640)),
        (degrees(-90.0, 90.0), ust(), (180, 900)),
        (degrees(-90.0, 90.0), uxm(), (20, 740)),
        (degrees(-135.0, 135.0), ust(), (0, 1080)),
        (degrees(f64::NEG_INFINITY, 90.0), ust(), (0, 900)),
        (degrees(90.0, f64::INFINITY), uxm(), (740, 760)),
        (degrees(f64::NEG_INFINITY, f64::INFINITY), ug01(), (44, 725)),
        // 30.3 / 0.3515625 = 86.19, and 30.3 / 0.25 = 121.2.
        (degrees(-30.3, 30.3), ug01(), (298, 470)),
        (degrees(-30.3, 30.3), ust(), (419, 661)),
        // One step of the first, three of the second.
        (degrees(-0.3, 0.3), urg(), (384, 384)),
        (degrees(-0.3, 0.3), utm(), (539, 541)),
        (degrees(0.351_562_5, 0.5), urg(), (385, 385)),
        (degrees(0.351_562_5, 0.5), utm(), (542, 542)),
        (degrees(-119.6, 119.9), ug01(), (44, 725)),
        (steps(44, 725), ust(), (44, 725)),
        (steps(0, 1080), ust(), (0, 1080)),
        (steps(44, 725), ug01(), (44, 725)),
        (steps(0, 768), ust(), (0, 768)),
        (Window::FULL, ust(), (0, 1080)),
        (Window::FULL, ug01(), (44, 725)),
        (Window::FULL, Geometry::URG_04LX, (0, 768)),
    ] {
        let found = resolved(window, geometry);
        assert_eq!(found, Ok(expected), "{window} of {geometry:?}");
    }
}

#[test]
fn a_window_that_is_not_measured_names_what_is() {
    let degrees = |from, to| Window::degrees(from..=to).unwrap();
    let coarse = geometry("UST-10LX", [23, 60_000, 36, 0, 27, 13, 2400]);
    for (window, geometry, text) in [
        (
            Window::new(0..=768).unwrap(),
            ug01(),
            "invalid window of steps 0..=768: this sensor measures steps 44..=725 \
             (-119.53 to 119.88 degrees), 0.352 degrees apart",
        ),
        (
            Window::new(0..=1080).unwrap(),
            Geometry::URG_04LX,
            "invalid window of steps 0..=1080: this sensor measures steps 44..=725 \
             (-119.53 to 119.88 degrees), 0.352 degrees apart",
        ),
        (
            degrees(-120.0, 30.5),
            ug01(),
            "invalid window from -120 to 30.5 degrees: this sensor measures steps 44..=725 \
             (-119.53 to 119.88 degrees), 0.352 degrees apart",
        ),
        (
            degrees(-135.0, 0.0),
            uxm(),
            "invalid window from -135 to 0 degrees: this sensor measures steps 0..=760 \
             (-95.00 to 95.00 degrees), 0.250 degrees apart",
        ),
        (
            degrees(0.1, 0.4),
            coarse,
            "invalid window from 0.1 to 0.4 degrees: this sensor measures steps 0..=27 \
             (-130.00 to 140.00 degrees), 10.000 degrees apart",
        ),
    ] {
        let error = resolved(window, geometry).unwrap_err();
        assert_eq!(error.to_string(), text);
        assert_eq!(error, WindowError::NotMeasured { window, geometry }.into());
    }
}

#[test]
fn a_scan_holds_values_of_18_bits() {
    let build = |values: Vec<u32>| {
        let window = Window::degrees(-0.4..=0.4).unwrap();
        Scan::builder(window, values).geometry(uxm()).build()
    };
    let scan = build(vec![99, 100_000, (1 << 18) - 1]).unwrap();
    assert_eq!((scan.window().start(), scan.len()), (379, 3));
    assert!(scan.raw_values().eq([99, 100_000, 262_143]));
    assert!(scan.distances().eq([None, Some(100_000), None]));
    let ranges: Vec<f32> = scan.ranges().collect();
    assert!(ranges[0].is_nan() && ranges[1..] == [100.0, f32::INFINITY]);
    assert_eq!((scan.range_min(), scan.range_max()), (0.099, 100.001));
    assert_eq!((scan.nearest().unwrap().step, scan.points().count()), (380, 1));
    assert!((scan.angle_min() + 0.25_f32.to_radians()).abs() < 1e-6);
    let again = Scan::builder(Window::degrees(-0.4..=0.4).unwrap(), [99, 100_000, 262_143]);
    assert_eq!(again.like(&scan).build().unwrap(), scan);
    let error = build(vec![99, 1 << 18, 7]).unwrap_err();
    assert_eq!(error, ScanError::Value { index: 1, found: 1 << 18, max: 262_143 });
    let text = "invalid scan: expected values of 0 to 262143, found 262144 at index 1";
    assert_eq!(error.to_string(), text);
}
