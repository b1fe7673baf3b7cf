//! What each model measures, and what its values mean. The numbers are those of the protocol texts
//! and of replies of real sensors.

use std::ops::RangeInclusive;
use std::time::Duration;

use proptest::prelude::*;
use tokio_scip::protocol::scip2::{self, Content, Request};
use tokio_scip::protocol::{Command, Geometry, Measurement, Reply, WindowError};
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
    let request = Request::new(scip2::Command::Parameters, None);
    match scip2::Reply::parse(&request, frame.as_bytes()).unwrap().content {
        Content::Parameters(parameters) => parameters.geometry(),
        content => panic!("{content:?}"),
    }
}

/// A UST-10LX with these steps.
fn with_steps(steps_per_revolution: u16, steps: RangeInclusive<u16>, front: u16) -> Geometry {
    let [first, last] = [*steps.start(), *steps.end()].map(u32::from);
    let numbers = [23, 60_000, steps_per_revolution.into(), first, last, front.into(), 2400];
    geometry("UST-10LX", numbers)
}

fn clustered(first: u16, last: u16, cluster_count: u8) -> Window {
    Window::new(first..=last).unwrap().with_cluster_count(cluster_count).unwrap()
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

/// By its specification, C-42-04213.
fn fine_ust() -> Geometry {
    geometry("UST-10LX-H01", [21, 30_000, 2880, 0, 2160, 1080, 2400])
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
        (fine_ust(), 2880, 0..=2160, 21..=30_000, 25, [-135.0, 135.0]),
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
/// others. `greatest` is its longest distance.
fn check_codes(geometry: Geometry, infinite: &[u32], others: &[u32], greatest: u32) {
    let least = *geometry.distances().start();
    let far = geometry.far_value();
    assert!(
        infinite.contains(&far) || infinite.is_empty() && far > greatest,
        "{geometry:?}: {far}"
    );
    for value in (0..70_000).chain(99_990..100_010).chain([119_999, 120_000, (1 << 18) - 1]) {
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
    check_codes(Geometry::URG_04LX, &[0, 6, 16], &up_to_19, 4094);
    // As one told.
    let name = "UBG-04LX-F01[Rapid-URG](Hokuyo Automatic Co., Ltd.)";
    let ubg = geometry(name, [20, 5600, 1024, 44, 725, 384, 2400]);
    for geometry in [urg(), ug01(), ubg] {
        check_codes(geometry, &[0], &up_to_19, 5599);
    }
    // Recordings of three have 322 times 11,000 mm, next to errors and to 3 m, and twice 10,999 mm.
    let uhg = geometry("UHG-08LX", [30, 11_000, 1024, 0, 768, 384, 900]);
    check_codes(uhg, &[0], &up_to_19, 10_999);
    check_codes(utm(), &[1], &[1, 2, 3, 4, 5], 60_000);
    let ethernet = |model| geometry(model, [23, 60_000, 1440, 0, 1080, 540, 2400]);
    for geometry in [ust(), ethernet("UST-20LX"), ethernet("UTM-30LX-EW")] {
        let greatest = *geometry.distances().end();
        check_codes(geometry, &[65_533], &[4, 65_533], greatest);
    }
    // An object that is too near, 65533, is nothing beyond the range.
    let uam = geometry("UAM-05LP-T301", [20, 40_000, 1440, 0, 1080, 540, 2000]);
    check_codes(uam, &[65_534], &[65_532, 65_533, 65_535], 40_000);
    // Users of a UXM-30LAH-EWA take 120,000 mm for nothing in range
    // (RoadUserInteraction/div_datalogger_postprocess). 65533 is a distance like any other.
    let far = geometry("UXM-30LAH-EWA", [23, 120_000, 2880, 0, 1520, 760, 1200]);
    check_codes(far, &[], &[], 119_999);
    check_codes(uxm(), &[], &[], 99_999);
    for (geometry, value, text) in [
        (Geometry::URG_04LX, 1, "error code 1: Reflected light has low intensity"),
        (urg(), 1, "error code 1: little light returned"),
        (utm(), 1, "error code 1: nothing in range"),
        (utm(), 2, "error code 2: object too near"),
        (utm(), 22, "error code 22: value below the measurable distances"),
        (ust(), 1, "error code 1: value below the measurable distances"),
        (ust(), 4, "error code 4: object before the near end of the range"),
        (ust(), 65_533, "error code 65533: nothing in range"),
        (uam, 65_532, "error code 65532: the laser is off"),
        (uam, 65_533, "error code 65533: object too near"),
        (uam, 65_534, "error code 65534: nothing in range"),
        (uam, 65_535, "error code 65535: other error"),
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
    let scan = build(vec![99, 99_999, (1 << 18) - 1]).unwrap();
    assert_eq!((scan.window().start(), scan.len()), (379, 3));
    assert!(scan.raw_values().eq([99, 99_999, 262_143]));
    assert!(scan.distances().eq([None, Some(99_999), None]));
    let ranges: Vec<f32> = scan.ranges().collect();
    assert!(ranges[0].is_nan() && ranges[1..] == [99.999, f32::INFINITY]);
    assert_eq!((scan.range_min(), scan.range_max()), (0.099, 100.001));
    assert_eq!((scan.nearest().unwrap().step, scan.points().count()), (380, 1));
    assert!((scan.angle_min() + 0.25_f32.to_radians()).abs() < 1e-6);
    let again = Scan::builder(Window::degrees(-0.4..=0.4).unwrap(), [99, 99_999, 262_143]);
    assert_eq!(again.like(&scan).build().unwrap(), scan);
    let error = build(vec![99, 1 << 18, 7]).unwrap_err();
    assert_eq!(error, ScanError::Value { index: 1, found: 1 << 18, max: 262_143 });
    let text = "invalid scan: expected values of 0 to 262143, found 262144 at index 1";
    assert_eq!(error.to_string(), text);
}

#[test]
fn a_urg_04lx_changes_no_window() {
    let degrees = |from, to| Window::degrees(from..=to).unwrap();
    for window in [
        Window::FULL,
        Window::DETECTION.with_cluster_count(4).unwrap(),
        clustered(0, 43, 2),
        degrees(-135.0, 135.0),
        degrees(-0.1, 0.1),
    ] {
        let steps = (window.start(), window.end());
        assert_eq!(resolved(window, Geometry::URG_04LX), Ok(steps));
        // After a sensor of another model, too.
        let before = window.resolve(&ust()).unwrap();
        let again = before.resolve(&Geometry::URG_04LX).unwrap();
        assert_eq!((again, again.is_same_wish(&window)), (window, true));
    }
    let last = with_steps(1024, 44..=9999, 384);
    let all = Window::DETECTION.resolve(&last).unwrap();
    assert_eq!((all.start(), all.end(), all.points()), (44, 9999, 9956));
}

#[test]
fn wishes_differ_where_windows_are_equal() {
    let wishes = [
        Window::DETECTION,
        clustered(44, 725, 1),
        Window::degrees(-119.6..=119.9).unwrap(),
        Window::degrees(-119.6..=119.91).unwrap(),
    ];
    for (n, one) in wishes.iter().enumerate() {
        for (m, other) in wishes.iter().enumerate() {
            assert_eq!(one, other);
            assert_eq!(one.is_same_wish(other), n == m);
        }
        assert!(!one.is_same_wish(&one.with_cluster_count(2).unwrap()));
    }
    assert!(!clustered(44, 725, 1).is_same_wish(&clustered(44, 724, 1)));
}

/// No panic, and a command that a sensor knows.
#[test]
fn a_command_has_no_steps_that_it_cannot_name() {
    for (steps, bytes) in [(0..=1080, "G00076801"), (1200..=9999, "G76876801")] {
        let all = Window::DETECTION.resolve(&with_steps(1440, steps, 540)).unwrap();
        let command = Command::Distances(all);
        assert_eq!(command.to_string(), bytes);
        assert!(Reply::parse(&command, format!("{bytes}\n0\n0000").as_bytes()).is_err());
    }
}

proptest! {
    /// Steps that are nearer to a bound than rounding count as inside or not.
    #[test]
    fn a_window_of_degrees_has_the_steps_inside(
        steps_per_revolution in prop_oneof![Just(1024), Just(1440), 1_u16..20_000],
        first in 0_u16..3000,
        count in 0_u16..7000,
        front in 0_u16..9999,
        bounds in prop::array::uniform2(-135.0_f64..=135.0),
    ) {
        let [from, to] = [bounds[0].min(bounds[1]), bounds[0].max(bounds[1])];
        let steps = first..=first + count;
        let geometry = with_steps(steps_per_revolution, steps.clone(), front);
        let step_angle = 360.0 / f64::from(steps_per_revolution);
        let is_inside = |step: &i32| (from..=to).contains(&(f64::from(*step) * step_angle));
        // Counted from the front: 135 degrees are 7,500 steps of 20,000.
        let inside = (-7501..=7501).filter(is_inside).map(|step| step + i32::from(front));
        let inside: Vec<i32> = inside.collect();
        let is_near = |bound: f64| {
            ((bound / step_angle).round() * step_angle - bound).abs() < 1e-6
        };
        let Ok(window) = Window::degrees(from..=to) else { return Ok(()) };
        prop_assume!(!is_near(from) && !is_near(to));
        let measured = |step: i32| u16::try_from(step).ok().filter(|step| steps.contains(step));
        let expected = match inside[..] {
            [] => None,
            [only] => measured(only).zip(measured(only)),
            [one, .., other] => measured(one).zip(measured(other)),
        };
        let found = window.resolve(&geometry).ok().map(|found| (found.start(), found.end()));
        prop_assert_eq!(found, expected);
    }

    /// Each bound is the direction of a step, as far as a float can tell.
    #[test]
    fn a_window_of_degrees_has_the_steps_at_its_bounds(
        steps_per_revolution in prop_oneof![Just(1024), Just(1440), 720_u16..20_000],
        bounds in prop::array::uniform2(-270_i32..=270),
    ) {
        let geometry = with_steps(steps_per_revolution, 0..=9999, 5000);
        let [first, last] = [bounds[0].min(bounds[1]), bounds[0].max(bounds[1])];
        let direction = |step: i32| f64::from(step) * 360.0 / f64::from(steps_per_revolution);
        let Ok(window) = Window::degrees(direction(first)..=direction(last)) else { return Ok(()) };
        let expected = [first, last].map(|step| u16::try_from(step + 5000).unwrap());
        let found = window.resolve(&geometry).unwrap();
        prop_assert_eq!([found.start(), found.end()], expected);
    }
}

#[test]
fn an_infinite_bound_reaches_the_last_step_of_any_model() {
    let ust = ust();
    for (interval, urg, wide) in [
        (125.0..=f64::INFINITY, None, Some(1040..=1080)),
        (f64::NEG_INFINITY..=-125.0, None, Some(0..=40)),
        (100.0..=f64::INFINITY, Some(669..=725), Some(940..=1080)),
        (136.0..=f64::INFINITY, None, None),
        (f64::NEG_INFINITY..=-136.0, None, None),
        (f64::INFINITY..=f64::INFINITY, None, None),
        (f64::INFINITY..=0.0, None, None),
    ] {
        let window = Window::degrees(interval.clone());
        let steps = |geometry: &Geometry| {
            let window = window.as_ref().ok()?.resolve(geometry).ok()?;
            Some(window.start()..=window.end())
        };
        assert_eq!(steps(&Geometry::URG_04LX), urg, "{interval:?}");
        assert_eq!(steps(&ust), wide, "{interval:?}");
    }
}
