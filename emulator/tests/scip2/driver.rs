//! What the driver parses is what the sensor measured: all models, windows and clusters.

use std::ops::RangeInclusive;
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::sleep;
use tokio_scip::protocol::scip2::{
    Command, Content, Data, Label, Reply, Request, Scan, State, Stream,
};
use tokio_scip::{Geometry, Measurement, Window};
use urg_emulator::{Link, Model, Room, Values, World, WorldTime};

use super::{MODELS, sensor};
use crate::listen_bytes;

/// Sends a request, and returns the driver's reading of each reply.
async fn ask(link: &mut Link, command: Command, label: &mut u64, replies: u8) -> Vec<Reply> {
    *label += 1;
    let request = Request::new(command, Label::numbered(*label));
    link.write_all(&[request.bytes(), b"\n"].concat()).await.unwrap();
    let mut found = Vec::new();
    for _ in 0..replies {
        let frame = listen_bytes(link).await;
        let frame = frame.strip_suffix(b"\n\n").unwrap();
        found.push(Reply::parse(&request, frame).unwrap());
    }
    found
}

fn scan(reply: Reply) -> Scan {
    match reply.content {
        Content::Scan(scan) => scan,
        other => panic!("{other:?}"),
    }
}

/// Windows that each model can be asked for.
fn windows(model: Model) -> Vec<RangeInclusive<u16>> {
    let last = if matches!(model, Model::Utm30lx | Model::Ust10lx) { 1080 } else { 768 };
    let all = 0..=last;
    let short = (1..=23).map(|length| 100..=100 + length);
    [all, 44..=725, 0..=0, last..=last, 384..=384].into_iter().chain(short).collect()
}

/// Least value of each cluster, without codes where there is a distance.
fn clustered(values: &[u32], cluster: u8, geometry: &Geometry) -> Vec<u32> {
    let groups = values.chunks(cluster.into());
    let least = |group: &[u32]| {
        let is_code = |value: u32| matches!(geometry.measurement(value), Measurement::Error(_));
        let distances = group.iter().filter(|value| !is_code(**value));
        distances.min().or(group.iter().min()).copied().unwrap()
    };
    groups.map(least).collect()
}

#[tokio::test(start_paused = true)]
async fn every_window_and_cluster_is_read_as_measured() {
    for model in MODELS {
        let (sender, receiver) = std::sync::mpsc::channel();
        let mut room = Room::hard(7);
        let world = move |time: WorldTime, values: &mut Values| {
            room.measure(time, values);
            sender.send(values.to_vec()).unwrap();
        };
        let emulator = sensor(model).world(world).laser(true).build();
        let mut link = emulator.link();
        let mut label = 0;
        sleep(Duration::from_secs(1)).await;
        let parameters = ask(&mut link, Command::Parameters, &mut label, 1).await.remove(0);
        let Content::Parameters(parameters) = parameters.content else { panic!() };
        let geometry = parameters.geometry();

        let kinds = [Data::ShortDistances, Data::Distances, Data::Intensities];
        let kinds = match model {
            Model::Utm30lx => &kinds[..],
            Model::Ust10lx => &kinds[1..],
            _ => &kinds[..2],
        };
        for (window, cluster) in
            windows(model).into_iter().flat_map(|w| [1, 2, 3, 64, 99].map(|c| (w.clone(), c)))
        {
            let asked = Window::new(window.clone()).unwrap().with_cluster_count(cluster).unwrap();
            for &data in kinds {
                let latest = Command::Latest { data, window: asked };
                let one = ask(&mut link, latest, &mut label, 1).await;
                let stream = Stream::new(data, asked).ending_after(2).unwrap();
                let stream = Command::Stream(stream);
                let more = ask(&mut link, stream, &mut label, 3).await;
                assert_eq!(more[0].status.to_string(), "00");
                let scans = one.into_iter().chain(more.into_iter().skip(1)).map(scan);
                for scan in scans {
                    let measured: Vec<u32> = receiver.recv().unwrap();
                    let measured = &measured[usize::from(*window.start())..=(*window.end()).into()];
                    let mut expected = clustered(measured, cluster, &geometry);
                    if data == Data::ShortDistances {
                        expected.iter_mut().for_each(|value| *value = (*value).min(4095));
                    }
                    assert_eq!(scan.distances(), expected, "{model:?} {window:?} {cluster}");
                    let bright = |value: &u32| match value {
                        0..20 | 65_533 => 0,
                        value => (2_000_000 / (value + 1000)).max(370),
                    };
                    let expected: Vec<u32> = match data {
                        Data::Intensities => expected.iter().map(bright).collect(),
                        _ => Vec::new(),
                    };
                    assert_eq!(scan.intensities(), expected);
                }
                // The stream has switched it off.
                ask(&mut link, Command::LaserOn, &mut label, 1).await;
            }
        }
        assert!(receiver.try_recv().is_err());
        assert_eq!(emulator.counts().malformed, 0);
    }
}

#[tokio::test(start_paused = true)]
async fn the_driver_reads_what_each_model_says() {
    for (model, name, steps, distances) in [
        (Model::Urg04lx, "URG-04LX(Hokuyo Automatic Co.,Ltd.)", 44..=725, 20..=5600),
        (
            Model::Urg04lxUg01,
            "URG-04LX-UG01(Simple-URG)(Hokuyo Automatic Co.,Ltd.)",
            44..=725,
            20..=5600,
        ),
        (Model::Utm30lx, "UTM-30LX(Hokuyo Automatic Co.,Ltd.)", 0..=1080, 23..=60_000),
        (Model::Ust10lx, "UST-10LX", 0..=1080, 20..=30_000),
    ] {
        let mut link = sensor(model).clock(Duration::from_millis(0x12_3456), 0.0).build().link();
        let mut label = 0;
        let mut contents = Vec::new();
        for command in [Command::Version, Command::Parameters, Command::State, Command::Clock] {
            contents.push(ask(&mut link, command, &mut label, 1).await.remove(0).content);
        }
        let [
            Content::Version(version),
            Content::Parameters(parameters),
            Content::State(State { clock, laser_on, .. }),
            Content::Clock(stamp),
        ] = &contents[..]
        else {
            panic!("{contents:?}");
        };
        assert_eq!(version.serial_number, "H0000001");
        assert_eq!(parameters.model, name);
        assert_eq!((&parameters.steps, &parameters.distances), (&steps, &distances));
        assert_eq!(*laser_on, Some(false));
        assert!(clock.unwrap().abs_diff(0x12_3456) < 1000);
        assert!(stamp.since_zero().as_millis().abs_diff(0x12_3456) < 1000);
    }
}
