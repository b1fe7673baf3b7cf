//! Windows in the steps of a sensor, and windows made wider.

#![allow(clippy::unwrap_used)]

use proptest::prelude::*;

use super::*;
use crate::protocol::scip2::Parameters;

fn window(start: u16, end: u16, cluster_count: u8) -> Window {
    Window::new(start..=end).unwrap().with_cluster_count(cluster_count).unwrap()
}

/// First and last step of every point.
fn points(window: Window) -> Vec<(u16, u16)> {
    let (end, cluster) = (window.end(), u16::from(window.cluster_count()));
    (window.start()..=end)
        .step_by(usize::from(cluster))
        .map(|first| (first, end.min(first + cluster - 1)))
        .collect()
}

#[test]
fn a_widened_window_keeps_the_points() {
    let mut refused = 0;
    for start in 0..=768 {
        for end in [start, start + 1, start + 7, start + 41, 725, 764, 767, 768] {
            if end < start || end > 768 {
                continue;
            }
            for cluster_count in [1, 2, 4, 5, 99] {
                for added in 0..4 {
                    let narrow = window(start, end, cluster_count);
                    let Some((wide, skip)) = narrow.widened(added) else {
                        refused += 1;
                        continue;
                    };
                    assert_eq!(wide.points(), narrow.points() + usize::from(added));
                    let kept = points(wide).into_iter().skip(skip).take(narrow.points());
                    assert!(kept.eq(points(narrow)), "{narrow} by {added}");
                }
            }
        }
    }
    assert!(refused > 0);
}

/// Geometry of a sensor with these steps.
fn geometry(steps_per_revolution: u16, steps: RangeInclusive<u16>, front: u16) -> Geometry {
    Parameters {
        model: "UST-10LX".into(),
        distances: 23..=60_000,
        steps_per_revolution,
        steps,
        front,
        motor_speed: 2400,
        other: Vec::new(),
    }
    .geometry()
}

fn resolved(window: Window, geometry: &Geometry) -> Option<(u16, u16)> {
    window.resolve(geometry).ok().map(|window| (window.start, window.end))
}

#[test]
fn a_urg_04lx_changes_no_window() {
    let ust = geometry(1440, 0..=1080, 540);
    let degrees = |from, to| Window::degrees(from..=to).unwrap();
    for window in [
        Window::FULL,
        Window::DETECTION.with_cluster_count(4).unwrap(),
        window(0, 43, 2),
        degrees(-135.0, 135.0),
        degrees(-0.1, 0.1),
    ] {
        let steps = (window.start, window.end);
        assert_eq!(resolved(window, &Geometry::URG_04LX), Some(steps));
        // After a sensor of another model, too.
        let before = window.resolve(&ust).unwrap();
        let again = before.resolve(&Geometry::URG_04LX).unwrap();
        assert_eq!((again, again.is_same_wish(&window)), (window, true));
    }
    let last = geometry(1024, 44..=9999, 384);
    let all = Window::DETECTION.resolve(&last).unwrap();
    assert_eq!((all.start, all.end, all.points()), (44, 9999, 9956));
}

#[test]
fn wishes_differ_where_windows_are_equal() {
    let wishes = [
        Window::DETECTION,
        window(44, 725, 1),
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
    assert!(!window(44, 725, 1).is_same_wish(&window(44, 724, 1)));
}

/// No panic, and a command that a sensor knows.
#[test]
fn a_command_has_no_steps_that_it_cannot_name() {
    use crate::protocol::{Command, Reply};
    for (steps, bytes) in [(0..=1080, "G00076801"), (1200..=9999, "G76876801")] {
        let all = Window::DETECTION.resolve(&geometry(1440, steps, 540)).unwrap();
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
        let geometry = geometry(steps_per_revolution, steps.clone(), front);
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
        prop_assert_eq!(resolved(window, &geometry), expected);
    }

    /// Each bound is the direction of a step, as far as a float can tell.
    #[test]
    fn a_window_of_degrees_has_the_steps_at_its_bounds(
        steps_per_revolution in prop_oneof![Just(1024), Just(1440), 720_u16..20_000],
        bounds in prop::array::uniform2(-270_i32..=270),
    ) {
        let geometry = geometry(steps_per_revolution, 0..=9999, 5000);
        let [first, last] = [bounds[0].min(bounds[1]), bounds[0].max(bounds[1])];
        let direction = |step: i32| f64::from(step) * 360.0 / f64::from(steps_per_revolution);
        let Ok(window) = Window::degrees(direction(first)..=direction(last)) else { return Ok(()) };
        let expected = [first, last].map(|step| u16::try_from(step + 5000).unwrap());
        prop_assert_eq!(resolved(window, &geometry), Some(expected.into()));
    }
}
