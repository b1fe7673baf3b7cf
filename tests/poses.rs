//! Poses, proved by sensors in a known scene: upright or upside down, each sensor's points, moved
//! by its pose, lie on the surfaces. The emulator finds its directions by code of its own.

use std::time::Duration;

use tokio_scip::Window;
use tokio_scip::scan::Pose;
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
