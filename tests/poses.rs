//! Poses, proved by sensors in a known scene: upright or upside down, each sensor's points, moved
//! by its pose, lie on the surfaces. The emulator finds its directions by code of its own. And any
//! poses move points as tf2 does.

use std::f64::consts::PI;
use std::time::Duration;

use proptest::prelude::*;
use tokio_scip::scan::{Point, Pose};
use tokio_scip::{Scan, Window};
use urg_emulator::{Emulator, Path, Scene};

use crate::common::builder;
use crate::common::random::{Random, seeds};

/// Distance in metres of a place from the nearest surface of [`scene`].
fn off(x: f64, y: f64) -> f64 {
    let room = (2.0 - x.abs()).abs().min((1.5 - y.abs()).abs());
    let pillar = ((x - 1.2).hypot(y - 0.7) - 0.2).abs();
    room.min(pillar)
}

/// A room with one pillar, so that no mirrored picture of it fits.
fn scene() -> Scene {
    Scene::new(0).without_noise().rectangle((-2.0, -1.5), (2.0, 1.5)).disc((1.2, 0.7), 0.2)
}

#[tokio::test(start_paused = true)]
async fn moved_points_lie_on_the_surfaces() {
    for seed in seeds("SCIP_POSES", 20) {
        let mut random = Random::new(seed);
        let mut between = |most: i64| (random.below(2001) as f64 / 1000.0 - 1.0) * most as f64;
        let (x, y, heading) = (between(1) * 0.8, between(1) * 0.8 - 0.4, between(4));
        for upside_down in [false, true] {
            let pose = Pose { x, y, heading, upside_down };
            let world = scene().sensor_on(Path::new([(Duration::ZERO, pose)]));
            let sensor = builder().connect(Emulator::builder().world(world).build()).await.unwrap();
            let scan = sensor.scan(Window::DETECTION).await.unwrap();
            let worst = |pose: Pose| {
                pose.transform_scan(&scan).map(|p| off(p.x.into(), p.y.into())).fold(0.0, f64::max)
            };
            assert!(scan.points().count() > 600);
            assert!(worst(pose) < 0.001, "{seed}: {pose:?}: {}", worst(pose));
            let wrong = Pose { upside_down: !upside_down, ..pose };
            assert!(worst(wrong) > 0.1, "{seed}: {pose:?}: {}", worst(wrong));
            // The vehicle's zones, moved into the sensor's frame, are where the points are.
            for (point, moved) in scan.points().zip(pose.transform_scan(&scan)) {
                let (x, y) = pose.inverse().transform(moved.x, moved.y);
                assert!((x - f64::from(point.x)).hypot(y - f64::from(point.y)) < 1e-5);
            }
        }
    }
}

fn near(a: (f64, f64), b: (f64, f64)) -> bool {
    (a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9
}

#[test]
fn a_moved_scan_keeps_what_the_sensor_measured() {
    let window = Window::new(384..=640).unwrap();
    let scan = Scan::builder(window, Vec::from_iter(20..277)).build().unwrap();
    let pose = Pose { x: 10.0, y: -4.0, heading: 1.0, upside_down: true };
    assert_eq!(pose.transform_scan(&scan).count(), 257);
    for (moved, point) in pose.transform_scan(&scan).zip(scan.points()) {
        assert_eq!(Point { x: point.x, y: point.y, ..moved }, point);
        let (x, y) = pose.transform(point.x, point.y);
        assert_eq!((moved.x, moved.y), (x as f32, y as f32));
    }
}

/// Rotates a point as tf2 does: roll about x, then yaw about z, in three dimensions.
fn rotated(pose: Pose, (x, y, z): (f64, f64, f64)) -> (f64, f64, f64) {
    let (sin, cos) = if pose.upside_down { (0.0, -1.0) } else { (0.0, 1.0) };
    let (y, z) = (y * cos - z * sin, y * sin + z * cos);
    let (sin, cos) = pose.heading.sin_cos();
    (x * cos - y * sin, x * sin + y * cos, z)
}

fn poses() -> impl Strategy<Value = Pose> {
    (-100.0..100.0, -100.0..100.0, -10.0..10.0, any::<bool>())
        .prop_map(|(x, y, heading, upside_down)| Pose { x, y, heading, upside_down })
}

proptest! {
    #[test]
    fn a_point_moved_there_and_back_is_where_it_was(
        pose in poses(), point in (-100.0..100.0, -100.0..100.0),
    ) {
        let (there_x, there_y) = pose.transform(point.0, point.1);
        prop_assert!(near(pose.inverse().transform(there_x, there_y), point));
        let nowhere = pose * pose.inverse();
        prop_assert!(near((nowhere.x, nowhere.y), (0.0, 0.0)) && nowhere.heading.abs() < 1e-9);
        prop_assert!(pose.inverse().heading.abs() <= PI && !nowhere.upside_down);
    }

    #[test]
    fn a_pose_moves_points_as_tf2_does(
        pose in poses(), inner in poses(), point in (-100.0..100.0, -100.0..100.0),
    ) {
        let (x, y, z) = rotated(pose, (point.0, point.1, 0.0));
        prop_assert!(near(pose.transform(point.0, point.1), (pose.x + x, pose.y + y)));
        prop_assert!(z.abs() < 1e-9);
        let (x, y) = inner.transform(point.0, point.1);
        prop_assert!(near((pose * inner).transform(point.0, point.1), pose.transform(x, y)));
    }
}
