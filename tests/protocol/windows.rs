//! Valid and invalid windows.

use tokio_scip::protocol::{Geometry, Window, WindowError};

#[test]
fn steps_are_0_to_9999() {
    assert_eq!((Window::FULL.start(), Window::FULL.end()), (0, 768));
    assert_eq!(Window::new(0..=9999).unwrap().points(), 10_000);
    assert_eq!(Window::new(9999..=10_000), Err(WindowError::Step { found: 10_000 }));
}

#[test]
fn angles_count_counter_clockwise_from_the_front() {
    for (step, degrees) in
        [(0, -135.0), (128, -90.0), (384, 0.0), (640, 90.0), (768, 135.0), (385, 0.351_562_5)]
    {
        assert_eq!(Geometry::URG_04LX.degrees(step), degrees);
    }
    assert!((Geometry::URG_04LX.degrees(Window::DETECTION.start()) - -119.53).abs() < 0.005);
    assert!((Geometry::URG_04LX.degrees(Window::DETECTION.end()) - 119.88).abs() < 0.005);
}

#[test]
fn a_window_cannot_be_invalid() {
    assert_eq!(Window::new(0..=768), Ok(Window::FULL));
    assert_eq!(Window::new(44..=725), Ok(Window::DETECTION));
    assert_eq!(Window::new(5..=5).unwrap().points(), 1);
    for (start, end) in [(6, 5), (768, 0)] {
        assert_eq!(Window::new(start..=end), Err(WindowError::Reversed { start, end }));
    }
    for (start, end, found) in
        [(10_000, 5, 10_000), (10_000, 10_001, 10_000), (5, u16::MAX, u16::MAX)]
    {
        assert_eq!(Window::new(start..=end), Err(WindowError::Step { found }));
    }
    for cluster_count in 0..=255 {
        let window = Window::FULL.with_cluster_count(cluster_count);
        match cluster_count {
            1..=99 => {
                let window = window.unwrap();
                assert_eq!(window.cluster_count(), cluster_count);
                let mut groups = 0;
                let mut steps = 0..=768;
                while steps.next().is_some() {
                    steps.by_ref().take(usize::from(cluster_count) - 1).for_each(drop);
                    groups += 1;
                }
                assert_eq!(window.points(), groups);
            }
            found => assert_eq!(window, Err(WindowError::ClusterCount { found })),
        }
    }
}

#[test]
fn degrees_are_the_steps_inside_the_interval() {
    let steps = |from: f64, to: f64| {
        Window::degrees(from..=to).map(|window| (window.start(), window.end()))
    };
    assert_eq!(steps(-90.0, 90.0), Ok((128, 640)));
    assert_eq!(steps(-135.0, 135.0), Ok((0, 768)));
    assert_eq!(steps(0.0, 0.0), Ok((384, 384)));
    assert_eq!(steps(-0.3, 0.3), Ok((384, 384)));
    assert_eq!(steps(0.1, 0.4), Ok((385, 385)));
    assert_eq!(steps(-119.54, 119.89), Ok((44, 725)));
    // Step 44 is at -119.53125 degrees; rounding may put a computed bound just past it.
    assert_eq!(steps(-119.531_25 + 1e-12, 119.9), Ok((44, 725)));
    assert_eq!(steps(-119.6, 90.0 - 1e-12), Ok((44, 640)));
    assert_eq!(steps((-std::f64::consts::FRAC_PI_2).to_degrees(), 0.0), Ok((128, 384)));
    assert_eq!(steps(f64::NEG_INFINITY, 0.0), Ok((44, 384)));
    assert_eq!(steps(0.0, f64::INFINITY), Ok((384, 725)));
    assert_eq!(steps(f64::NEG_INFINITY, f64::INFINITY), Ok((44, 725)));
}

#[test]
fn degrees_without_a_step_or_outside_the_revolution_are_refused() {
    for (from, to) in [
        (0.1, 0.2),
        (90.0, -90.0),
        (-135.1, 0.0),
        (0.0, 135.1),
        (-135.000_1, 135.0),
        (135.1, 200.0),
        (-1e300, 1e300),
        (f64::INFINITY, f64::INFINITY),
        (f64::NEG_INFINITY, f64::NEG_INFINITY),
        (f64::NEG_INFINITY, 135.1),
    ] {
        assert_eq!(Window::degrees(from..=to), Err(WindowError::Degrees { from, to }));
    }
    assert!(Window::degrees(f64::NAN..=0.0).is_err());
    assert!(Window::degrees(0.0..=f64::NAN).is_err());
}

#[test]
fn window_errors_name_what_is_valid() {
    let message = |error: WindowError| error.to_string();
    assert!(message(WindowError::Step { found: 10_000 }).ends_with("expected 0 to 9999"));
    assert!(message(WindowError::Reversed { start: 9, end: 3 }).ends_with("swap them"));
    assert!(message(WindowError::ClusterCount { found: 0 }).ends_with("expected 1 to 99"));
    assert!(message(WindowError::Degrees { from: 1.0, to: 0.0 }).contains("-135 to 135"));
    assert_eq!(Window::DETECTION.to_string(), "steps 44..=725");
    assert_eq!(
        Window::FULL.with_cluster_count(3).unwrap().to_string(),
        "steps 0..=768 in clusters of 3"
    );
}

/// First and last step of every point.
fn points(window: Window) -> Vec<(u16, u16)> {
    let (end, cluster) = (window.end(), u16::from(window.cluster_count()));
    (window.start()..=end)
        .step_by(usize::from(cluster))
        .map(|first| (first, end.min(first + cluster - 1)))
        .collect()
}

/// The driver adds up to three points to a poll. The other points stay the same.
#[test]
fn a_window_is_polled_with_its_points_and_up_to_three_more() {
    let mut polled = [0; 4];
    for start in 0..=768_u16 {
        for end in [start, start + 1, start + 7, start + 41, 725, 764, 767, 768] {
            if end < start || end > 768 {
                continue;
            }
            for cluster_count in [1, 2, 4, 5, 99] {
                let new = |steps| Window::new(steps).unwrap().with_cluster_count(cluster_count);
                let window = new(start..=end).unwrap();
                for added in 0..=4 {
                    let steps = added * u16::from(cluster_count);
                    let before = start.checked_sub(steps).map(|first| new(first..=end).unwrap());
                    let behind = new(start..=end + steps).unwrap();
                    let of_window = points(window);
                    let both = before.into_iter().chain([behind]);
                    for asked in both.filter(|asked| window.is_polled_as(*asked)) {
                        polled[usize::from(added)] += 1;
                        let all = points(asked);
                        assert_eq!(all.len(), of_window.len() + usize::from(added), "{asked}");
                        assert!(
                            all.starts_with(&of_window) || all.ends_with(&of_window),
                            "{asked}"
                        );
                        assert!(asked.end() <= 768, "{asked}");
                    }
                }
            }
        }
    }
    assert!(polled.iter().all(|count| *count > 1000), "{polled:?}");
}
