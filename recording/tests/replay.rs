//! The replay of a recording as an emulated sensor.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::Instant;
use tokio_scip::protocol::Command;
use tokio_scip::{Error, ErrorKind, Rate, Scan, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults};
use urg_recording::{Entry, Record, Recorder, ReplayPace};

use super::common::random::{Random, seeds};
use super::sink::{Sink, observed, polls, record, sensor, window};

/// Reads everything that a sensor delivers until its stream ends.
async fn drain(emulator: Emulator, window: Window, rate: Rate) -> Vec<Result<Scan, Error>> {
    let builder = Sensor::builder().depth(1 << 16);
    let sensor = builder.connect(emulator).await.unwrap();
    let mut scans = sensor.scans(window, rate).await.unwrap();
    let mut items = Vec::new();
    while let Some(item) = scans.next().await {
        items.push(item);
    }
    assert!(matches!(sensor.watch_state().get(), State::Closed { error: None, .. }));
    assert_eq!(sensor.stats().disconnects, 0);
    items
}

fn values(items: &[Result<Scan, Error>]) -> Vec<Vec<u32>> {
    items.iter().flatten().map(|scan| scan.raw_values().collect::<Vec<_>>()).collect()
}

#[tokio::test(start_paused = true)]
async fn a_replay_delivers_every_kind_of_window() {
    for window in [
        Window::DETECTION,
        Window::FULL,
        window(44, 725, 4),
        window(0, 768, 99),
        window(2, 2, 1),
        window(100, 103, 3),
    ] {
        let sink = Sink::new();
        let recorded = record(sensor(), &sink, window, 20).await;
        for (pace, rate) in [
            (ReplayPace::Recorded, Rate::hz(10.0)),
            (ReplayPace::Recorded, Rate::UNLIMITED),
            (ReplayPace::Max, Rate::hz(10.0)),
            (ReplayPace::Max, Rate::UNLIMITED),
        ] {
            let replayed = drain(sink.open().replay(pace).unwrap(), window, rate).await;
            assert!(replayed.iter().all(Result::is_ok), "{window} {pace:?} {rate}: {replayed:?}");
            assert_eq!(values(&replayed), values(&recorded), "{window} {pace:?} {rate}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_recording_of_a_replay_has_the_same_bytes() {
    let (first, second) = (Sink::new(), Sink::new());
    record(sensor(), &first, Window::DETECTION, 40).await;
    record(first.open().replay(ReplayPace::Recorded).unwrap(), &second, Window::DETECTION, 40)
        .await;
    let bytes = |sink: &Sink| {
        polls(&sink.records()).into_iter().map(|reply| reply.bytes).collect::<Vec<_>>()
    };
    assert_eq!(bytes(&first), bytes(&second));
    let stamps = |sink: &Sink| {
        let stamp = |record: Record| match record.entry {
            Entry::Scan(scan) => Some(scan.stamp),
            Entry::Reply(reply) => reply.command.map(|_| reply.stamp),
            _ => None,
        };
        sink.records().into_iter().filter_map(stamp).collect::<Vec<_>>()
    };
    // Opening asks for `V` twice, and a replay may answer the first with the second one's
    // reply.
    assert_eq!(stamps(&first)[2..], stamps(&second)[2..]);
    assert_eq!(first.open().metadata(), second.open().metadata());
}

#[tokio::test(start_paused = true)]
async fn a_replay_takes_the_recorded_time_or_none() {
    let sink = Sink::new();
    record(sensor(), &sink, Window::DETECTION, 50).await;
    let stamps = |scans: &[Scan]| scans.iter().map(Scan::first_ray_stamp).collect::<Vec<_>>();
    let recorded: Vec<Scan> = sink.open().scans().map(Result::unwrap).collect();
    let mut took = Vec::new();
    for pace in [ReplayPace::Recorded, ReplayPace::Max] {
        let began = Instant::now();
        let replay = sink.open().replay(pace).unwrap();
        let replayed = drain(replay, Window::DETECTION, Rate::UNLIMITED).await;
        took.push(began.elapsed());
        let replayed: Vec<Scan> = replayed.into_iter().map(Result::unwrap).collect();
        assert_eq!(stamps(&replayed), stamps(&recorded), "{pace:?}");
    }
    // 49 periods of 100 ms, and the time of opening.
    assert!(
        took[0] > Duration::from_millis(4890) && took[0] < Duration::from_millis(5100),
        "{took:?}"
    );
    assert!(took[1] < Duration::from_millis(200), "{took:?}");
}

#[tokio::test(start_paused = true)]
async fn damaged_and_refused_replies_are_replayed_as_such() {
    let kinds = |items: &[Result<Scan, Error>]| {
        let kind = |item: &Result<Scan, Error>| match item {
            Ok(_) => "scan",
            Err(error) => match error.kind() {
                ErrorKind::Malformed { .. } => "malformed",
                ErrorKind::Refused { .. } | ErrorKind::NotConfirmed { .. } => "refused",
                _ => "other",
            },
        };
        items.iter().map(kind).collect::<Vec<_>>()
    };
    // Replies 0 to 2 belong to opening; replies to fences count, too.
    let faults = Faults::none()
        .at(5, Fault::Drop(700..701))
        // The poll, the `L1` that follows, its fence, and the repeated poll.
        .at(9, Fault::Status(b'7'))
        .at(10, Fault::Status(b'7'))
        .at(11, Fault::Status(b'7'))
        .at(12, Fault::Status(b'7'))
        .at(14, Fault::Drop(14..16));
    let sink = Sink::new();
    let emulator = sensor();
    emulator.set_faults(faults);
    let recorded = record(emulator, &sink, Window::DETECTION, 30).await;
    let expected = kinds(&recorded);
    assert!(expected.contains(&"malformed") && expected.contains(&"refused"), "{expected:?}");
    let replay = sink.open().replay(ReplayPace::Max).unwrap();
    let replayed = drain(replay, Window::DETECTION, Rate::hz(10.0)).await;
    assert_eq!(kinds(&replayed), expected);
    assert_eq!(values(&replayed), values(&recorded));
}

#[tokio::test(start_paused = true)]
async fn another_window_shows_the_recorded_part_of_it() {
    let sink = Sink::new();
    let recorded = record(sensor(), &sink, window(100, 199, 1), 10).await;
    let open = || sink.open().replay(ReplayPace::Max).unwrap();

    let part = drain(open(), window(120, 139, 1), Rate::UNLIMITED).await;
    let expected: Vec<_> = values(&recorded).iter().map(|all| all[20..40].to_vec()).collect();
    assert_eq!(values(&part), expected);

    let groups = drain(open(), window(100, 199, 50), Rate::UNLIMITED).await;
    let smallest =
        |all: &Vec<u32>| all.chunks(50).map(|group| *group.iter().min().unwrap()).collect();
    assert_eq!(values(&groups), values(&recorded).iter().map(smallest).collect::<Vec<Vec<_>>>());

    // The recording has no values on the left.
    let wider = drain(open(), window(90, 199, 1), Rate::UNLIMITED).await;
    for (wide, all) in values(&wider).iter().zip(values(&recorded)) {
        assert_eq!((&wide[..7], &wide[10..]), (&[19; 7][..], &all[..]));
    }
}

#[tokio::test(start_paused = true)]
async fn a_replayed_sensor_answers_as_recorded() {
    let sink = Sink::new();
    let original = Emulator::builder().version_lines(["VEND:x", "FIRM:1", "SERI:42"]).build();
    let recorded = record(original, &sink, Window::DETECTION, 5).await;
    let emulator = sink.open().replay(ReplayPace::Max).unwrap();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    assert_eq!(sensor.version().await.unwrap().serial_number.to_string(), "42");
    // Fences do not consume a scan.
    sensor.laser_off().await.unwrap();
    assert!(!emulator.is_laser_on());
    sensor.laser_on().await.unwrap();
    for expected in values(&recorded) {
        assert!(sensor.scan(Window::DETECTION).await.unwrap().raw_values().eq(expected));
    }
    // Then the recording is over.
    let end = sensor.scan(Window::DETECTION).await.unwrap_err();
    assert!(matches!(end.kind(), ErrorKind::Closed), "{end:?}");
    let again = Sensor::builder().connect(emulator).await.unwrap_err();
    assert!(matches!(again.kind(), ErrorKind::NoSuchPort { .. }), "{again:?}");
}

#[tokio::test(start_paused = true)]
async fn a_replay_has_the_first_real_version() {
    let sink = Sink::new();
    let emulator = sensor();
    // A fence precedes it. The line feed after the status is lost.
    emulator.set_faults(Faults::none().at(1, Fault::Drop(3..4)));
    record(emulator, &sink, Window::DETECTION, 3).await;
    let first = sink.records().into_iter().find_map(|record| match record.entry {
        Entry::Reply(reply) if reply.command == Some(Command::Version) => Some(reply.bytes),
        _ => None,
    });
    assert!(first.unwrap().starts_with(b"V\n0VEND"));
    let replay = sink.open().replay(ReplayPace::Max).unwrap();
    let sensor = Sensor::builder().connect(replay).await.unwrap();
    let version = sensor.version().await.unwrap();
    assert_eq!(version.vendor.to_string(), sink.open().metadata()["vendor"]);
}

#[tokio::test(start_paused = true)]
async fn a_replay_obeys_the_laser_and_loses_nothing() {
    let sink = Sink::new();
    let recorded = record(sensor(), &sink, window(384, 385, 1), 2).await;
    let emulator = sink.open().replay(ReplayPace::Max).unwrap();
    let mut link = emulator.link();
    let mut ask = async |command: &[u8], length: usize| {
        link.write_all(command).await.unwrap();
        let mut reply = vec![0; length];
        link.read_exact(&mut reply).await.unwrap();
        String::from_utf8(reply).unwrap()
    };
    assert_eq!(ask(b"L0\n", 6).await, "L0\n0\n\n");
    assert_eq!(ask(b"G38438501\n", 13).await, "G38438501\n6\n\n");
    assert_eq!(ask(b"L1\n", 6).await, "L1\n0\n\n");
    drop(link);
    let sensor = Sensor::builder().connect(emulator).await.unwrap();
    for expected in values(&recorded) {
        assert!(sensor.scan(window(384, 385, 1)).await.unwrap().raw_values().eq(expected));
    }
}

/// Draws a window of at most 60 steps, half the time of one step.
fn any_window(random: &mut Random) -> Window {
    let start = 100 + random.below(500) as u16;
    match random.below(4) {
        0 | 1 => window(start, start, 1),
        2 => window(start, start + random.below(3) as u16, 3),
        _ => window(start, start + random.below(60) as u16, 1 + random.below(4) as u8),
    }
}

/// A request for one step is a fence unless the recorded window is that step.
#[tokio::test(start_paused = true)]
async fn a_single_step_takes_a_scan_of_that_step() {
    for seed in seeds("URG_SINGLE_STEPS", 40) {
        let mut random = Random::new(seed);
        let recorded_window = any_window(&mut random);
        let case = format!("seed {seed}, {recorded_window}");
        let sink = Sink::new();
        let recorded = values(&record(sensor(), &sink, recorded_window, 5).await);
        let emulator = sink.open().replay(ReplayPace::Max).unwrap();
        let mut link = emulator.link();
        let mut ask = async |command: String| {
            link.write_all(command.as_bytes()).await.unwrap();
            let mut reply = Vec::new();
            while !reply.ends_with(b"\n\n") {
                reply.push(link.read_u8().await.unwrap());
            }
        };
        ask("L1\n".into()).await;
        let mut taken = 0;
        for _ in 0..3 {
            let (start, end) = (recorded_window.start(), recorded_window.end());
            let step = *random.pick(&[start, end, 99]);
            taken += usize::from(start == end && step == end);
            ask(format!("G{step:03}{step:03}01\n")).await;
        }
        drop(link);
        let rest = drain(emulator, recorded_window, Rate::UNLIMITED).await;
        assert_eq!(values(&rest), recorded[taken..], "{case}, {taken}");
    }
}

/// Any other window, also one with as many points, has the recorded values of its own steps.
#[tokio::test(start_paused = true)]
async fn each_step_has_its_recorded_value_in_any_window() {
    for seed in seeds("URG_OTHER_WINDOWS", 40) {
        let mut random = Random::new(seed);
        let from = any_window(&mut random);
        let cluster = from.cluster_count();
        let shift = random.below(90) as u16;
        let asked = match random.below(3) {
            0 => any_window(&mut random),
            1 => window(from.start() - shift, from.end() - shift, cluster),
            _ => window(from.start() + shift, from.end() + shift, cluster),
        };
        if asked.steps() == 1 && asked != from {
            // To the emulated sensor it is a fence.
            continue;
        }
        let sink = Sink::new();
        record(sensor(), &sink, from, 3).await;
        let recorded: Vec<Vec<u32>> =
            sink.open().scans().map(|scan| scan.unwrap().raw_values().collect()).collect();
        let replay = sink.open().replay(ReplayPace::Max).unwrap();
        let replayed = values(&drain(replay, asked, Rate::UNLIMITED).await);
        assert_eq!(replayed.len(), recorded.len(), "seed {seed}, {from}, {asked}");
        // The recorded polls may have asked for three more points on each side.
        let margin = 3 * u16::from(cluster);
        let near = from.start().saturating_sub(margin)..=from.end() + margin;
        for (found, recorded) in replayed.iter().zip(&recorded) {
            for (value, start) in
                found.iter().zip((asked.start()..).step_by(asked.cluster_count().into()))
            {
                let steps = start..=asked.end().min(start + u16::from(asked.cluster_count()) - 1);
                let of = |step: u16| recorded[usize::from((step - from.start()) / cluster as u16)];
                let case = format!("seed {seed}, {from}, {asked}, {steps:?}");
                if steps.clone().all(|step| (from.start()..=from.end()).contains(&step)) {
                    assert_eq!(Some(*value), steps.map(of).min(), "{case}");
                } else if !steps.clone().any(|step| near.contains(&step)) {
                    assert_eq!(*value, 19, "{case}");
                }
            }
        }
    }
}

/// One point of the wider window is lost, so that the reply has the length of the
/// narrower one.
#[tokio::test(start_paused = true)]
async fn a_damaged_reply_is_never_replayed() {
    let (wide, narrow) = (window(43, 725, 1), Window::DETECTION);
    // Echo and status, 683 points in blocks of 64 bytes.
    let end = "G04372501\n0\n".len() + 683 * 2 + 22;
    let last_point = end - 3..end - 1;
    let emulator = sensor();
    // A fence and two `V`s precede it.
    emulator.set_faults(Faults::none().at(3, Fault::Drop(last_point)));
    let sink = Sink::new();
    let recorded = record(emulator, &sink, wide, 5).await;
    let error = recorded[0].as_ref().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "{error:?}");
    let whole: Vec<_> = values(&recorded).iter().map(|all| all[1..].to_vec()).collect();
    let replay = sink.open().replay(ReplayPace::Max).unwrap();
    let replayed = values(&drain(replay, narrow, Rate::hz(10.0)).await);
    assert_eq!(replayed, whole);
}

#[tokio::test(start_paused = true)]
async fn a_replay_follows_the_described_stream() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let rate = Rate::hz(4.0);
    let (original, mut scans) = observed(&recorder, sensor(), window(100, 199, 1), rate).await;
    let mut others = original.scans(window(300, 309, 1), rate).await.unwrap();
    recorder.describe(&original, &scans).await.unwrap();
    let (mut expected, mut seen) = (Vec::new(), Vec::new());
    for _ in 0..10 {
        let item = scans.next().await.unwrap();
        recorder.record(&item).unwrap();
        expected.push(item.unwrap().raw_values().collect::<Vec<_>>());
        seen.push(others.next().await.unwrap().unwrap().raw_values().collect::<Vec<_>>());
    }
    recorder.finish().await.unwrap();

    let open = || sink.open().replay(ReplayPace::Max).unwrap();
    assert_eq!(values(&drain(open(), window(100, 199, 1), rate).await), expected);
    let others = values(&drain(open(), window(300, 309, 1), rate).await);
    assert_eq!(others.len(), 10);
    assert!(others[1..].iter().all(|values| seen.contains(values)), "{others:?}");
}
