//! Scans made from any values: rays, points, and what is refused.

use std::f64::consts::TAU;
use std::time::Duration;

use proptest::prelude::*;
use tokio_scip::scan::{Point, Ray, ScanError};
use tokio_scip::{Scan, Window};

fn near(one: f32, other: f64) -> bool {
    (f64::from(one) - other).abs() < 1e-5
}

proptest! {
    /// A last cluster with fewer steps counts as whole, unless it is the only one.
    #[test]
    fn each_value_is_shown_where_and_when_it_was_measured(
        bounds in prop::array::uniform2(0_u16..=768),
        cluster_count in prop_oneof![Just(1_u8), 1_u8..=99],
        revolution in 0.02..0.2_f64,
        values in prop::collection::vec(prop_oneof![0_u32..30, 0_u32..4096], 769),
    ) {
        let first = bounds[0].min(bounds[1]);
        let window = Window::new(first..=bounds[0].max(bounds[1])).unwrap();
        let window = window.with_cluster_count(cluster_count).unwrap();
        let values = &values[..window.points()];
        let scan_time = Duration::from_secs_f64(revolution);
        let scan = Scan::builder(window, values).scan_time(scan_time).build().unwrap();
        let rays: Vec<Ray> = scan.rays().collect();
        prop_assert_eq!((rays.len(), scan.rays().len()), (values.len(), scan.len()));
        let cluster = f64::from(cluster_count);
        let middle = f64::from(first) + (cluster.min(window.steps() as f64) - 1.0) / 2.0;
        for (n, (ray, value)) in rays.iter().zip(values).enumerate() {
            let Ray { step, angle, measurement, offset, .. } = *ray;
            let (steps, range) = (n as f64 * cluster, f64::from(*value) / 1000.0);
            let direction = (middle + steps - 384.0) / 1024.0 * TAU;
            prop_assert_eq!(f64::from(step), f64::from(first) + steps);
            prop_assert_eq!(measurement.value(), *value);
            prop_assert!(near(angle, direction) && near(offset, revolution * steps / 1024.0));
            let point = ray.point();
            prop_assert_eq!(point.is_some(), (20..=4094).contains(value));
            if let Some(point) = point {
                let (x, y) = (range * direction.cos(), range * direction.sin());
                prop_assert!(near(point.x, x) && near(point.y, y));
                prop_assert_eq!(point, Point { range: range as f32, angle, step, offset, ..point });
            }
        }
        let points: Vec<Point> = rays.iter().filter_map(Ray::point).collect();
        prop_assert!(scan.points().eq(points.iter().copied()));
        // The first of several.
        let nearer = |one: Point, other: Point| if other.range < one.range { other } else { one };
        prop_assert_eq!(scan.nearest(), points.into_iter().reduce(nearer));
        prop_assert_eq!(Some(scan.angle_min()), rays.first().map(|ray| ray.angle));
        prop_assert_eq!(Some(scan.angle_max()), rays.last().map(|ray| ray.angle));
        prop_assert!(near(scan.angle_increment(), cluster / 1024.0 * TAU));
        let increment = scan.time_increment().as_secs_f64();
        prop_assert!((increment - revolution * cluster / 1024.0).abs() < 1e-8);
    }
}

#[test]
fn the_geometry_is_that_of_the_text() {
    let scan = Scan::builder(Window::FULL, [1000; 769]).build().unwrap();
    let degrees: Vec<f32> = scan.rays().map(|ray| ray.angle.to_degrees()).collect();
    assert_eq!((degrees[0], degrees[384], degrees[768]), (-135.0, 0.0, 135.0));
    assert_eq!(scan.time_increment(), Duration::from_nanos(97_656));
    assert_eq!((scan.range_min(), scan.range_max()), (0.019, 4.095));
    assert_eq!(scan.scan_time(), Duration::from_millis(100));
}

#[test]
fn values_that_do_not_fit_their_window_are_refused() {
    let build = |values: &[u32]| Scan::builder(Window::DETECTION, values).build();
    let error = build(&[1000; 681]).unwrap_err();
    let text = "invalid scan of steps 44..=725: expected 682 values, found 681";
    assert_eq!(error.to_string(), text);
    let mut values = [1000; 682];
    assert!(build(&values).is_ok());
    let with = |intensities: &[u32]| {
        Scan::builder(Window::DETECTION, values).intensities(intensities).build()
    };
    assert_eq!(with(&[]).unwrap().intensities(), None);
    assert_eq!(with(&[7; 682]).unwrap().intensities(), Some(&[7; 682][..]));
    assert!(matches!(with(&[7; 681]), Err(ScanError::Length { found: 681, .. })));
    (values[9], values[10]) = (4095, 4096);
    assert_eq!(build(&values).unwrap_err(), ScanError::Value { index: 10, found: 4096, max: 4095 });
}

#[test]
fn the_first_ray_follows_the_motor() {
    let before = |first, last, cluster_count, revolution| {
        let window = Window::new(first..=last).unwrap().with_cluster_count(cluster_count).unwrap();
        let scan = Scan::builder(window, vec![1000; window.points()]);
        let scan = scan.scan_time(Duration::from_millis(revolution)).build().unwrap();
        let before = scan.times().stamp.duration_since(scan.first_ray_stamp()).unwrap();
        assert_eq!(before, scan.received_at() - scan.times().first_ray_at);
        (before.as_secs_f64() * 1e5).round() / 100.0
    };
    // Steps from the rear to the first one, of 1,024: 128 to step 0.
    let ms = |steps: f64| ((1.0 - steps / 1024.0) * 1e4).round() / 100.0;
    assert_eq!(before(0, 768, 1, 100), 87.5);
    assert_eq!(before(44, 725, 1, 100), ms(128.0 + 44.0));
    assert_eq!(before(640, 700, 1, 100), ms(128.0 + 640.0));
    // The middle of the first cluster.
    assert_eq!(before(640, 700, 3, 100), ms(128.0 + 641.0));
    assert_eq!(before(0, 768, 1, 200), 175.0);
}
