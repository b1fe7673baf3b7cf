//! Intensities: on request, from the models that measure them.

use tokio_scip::protocol::scip2::Parameters;
use tokio_scip::{Rate, Scan, Window};
use urg_emulator::{Emulator, Model, Values, World, WorldTime};

use super::next;
use crate::common::builder;

/// Shows a number of each step, and another one as its intensity.
struct Numbers;

impl World for Numbers {
    fn measure(&mut self, _: WorldTime, values: &mut Values) {
        (1000..).zip(values.iter_mut()).for_each(|(number, slot)| *slot = number);
    }

    fn measure_intensities(&mut self, _: WorldTime, _: &Values, intensities: &mut Values) {
        (100_000..).zip(intensities.iter_mut()).for_each(|(number, slot)| *slot = number);
    }
}

fn check(scan: &Scan, model: Model) {
    let (start, clusters) = (u32::from(scan.window().start()), scan.window().cluster_count());
    let steps = (start..).step_by(clusters.into()).take(scan.len());
    let expected: Vec<u32> = steps.clone().map(|step| 100_000 + step).collect();
    let has_intensities = matches!(model, Model::Utm30lx | Model::Ust10lx);
    assert_eq!(scan.intensities(), has_intensities.then_some(&expected[..]), "{model:?}");
    assert!(scan.raw_values().eq(steps.map(|step| 1000 + step)), "{model:?} {scan:?}");
}

#[tokio::test(start_paused = true)]
async fn a_scan_has_them_if_asked_for() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let emulator = Emulator::builder().model(model).world(Numbers).build();
        let asking = builder().intensities(true);
        let sensor = asking.connect(emulator.clone()).await.unwrap();
        let clustered = Window::new(101..=300).unwrap().with_cluster_count(7).unwrap();
        // By GD or GE, and cut from a stream.
        for rate in [Rate::hz(0.5), Rate::UNLIMITED] {
            let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
            check(&next(&mut stream).await, model);
            check(&sensor.scan(Window::new(200..=210).unwrap()).await.unwrap(), model);
            check(&sensor.scan(clustered).await.unwrap(), model);
        }
        sensor.close().await;
        let plain = builder().connect(emulator).await.unwrap();
        assert_eq!(plain.scan(Window::DETECTION).await.unwrap().intensities(), None);
    }
}

/// A UST-10LX-H01 measures 2,161 steps (C-42-04213 p. 2). No known sensor has longer replies.
#[tokio::test(start_paused = true)]
async fn a_scan_of_eighths_of_a_degree_has_them() {
    let told =
        "MODL:UST-10LX-H01 DMIN:21 DMAX:30000 ARES:2880 AMIN:0 AMAX:2160 AFRT:1080 SCAN:2400";
    let pairs = told.split(' ').filter_map(|pair| pair.split_once(':'));
    let parameters = Parameters::from_pairs(pairs).unwrap();
    let model = Model::Ust10lx;
    let emulator = Emulator::builder().model(model).parameters(parameters).world(Numbers).build();
    let sensor = builder().intensities(true).connect(emulator).await.unwrap();
    for rate in [Rate::hz(0.5), Rate::UNLIMITED] {
        let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
        for _ in 0..100 {
            let scan = next(&mut stream).await;
            assert_eq!((scan.len(), scan.angle_min().to_degrees()), (2161, -135.0));
            check(&scan, model);
        }
    }
}
