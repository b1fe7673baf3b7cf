//! A black box: a recorder that holds what came before its trigger.

use std::time::Duration;

use tokio::time::Instant;
use tokio_scip::protocol::Command;
use tokio_scip::{Rate, Scan, Window};
use urg_recording::{Entry, Record, Recorder};

use super::common::limit::limit;
use super::common::random::Random;
use super::sink::{Sink, polls, sensor};

#[tokio::test(start_paused = true)]
async fn a_black_box_has_the_time_before_its_trigger() {
    limit();
    for seed in 0..30 {
        let mut random = Random::new(seed);
        let sink = Sink::new();
        let before = random.ms(20_000);
        let mut recorder = Recorder::builder().before(before).write_to(sink.clone()).unwrap();
        let emulator = sensor();
        let sensor = tokio_scip::Sensor::builder().connect(emulator.clone()).await.unwrap();
        recorder.observe(&sensor);
        let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        let (held, later) = (20 + random.below(300), random.below(50));
        let mut seen = Vec::new();
        let mut triggered = None;
        for n in 0..held + later {
            if n == held {
                recorder.trigger();
                triggered = Some(Instant::now());
            }
            if random.once_in(100) {
                emulator.unplug();
                tokio::time::sleep(random.ms(3000)).await;
                emulator.plug_in();
            }
            let item = scans.next().await.unwrap();
            recorder.record(&item).unwrap();
            seen.extend(item.ok().map(|scan| (Instant::now(), scan)));
        }
        let progress = recorder.finish().await.unwrap();
        let Some(triggered) = triggered else {
            assert_eq!((progress.scans, sink.records().len()), (0, 0), "{seed}");
            continue;
        };

        let records = sink.records();
        let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_))).count();
        assert_eq!((progress.scans, progress.lost), (scans as u64, 0), "{seed}");
        let (dropped, kept) = seen.split_at(seen.len() - scans);
        let age = |(at, _): &(Instant, _)| triggered.saturating_duration_since(*at);
        // The last item came up to a period before the trigger, or longer during an outage.
        let slack = Duration::from_millis(4000);
        assert!(dropped.iter().all(|scan| age(scan) > before.saturating_sub(slack)), "{seed}");
        assert!(kept.iter().all(|scan| age(scan) <= before), "{seed}: {before:?}");
        // Each scan has its reply, and one more poll may have a reply without a scan.
        let replies = polls(&records);
        assert!((scans..=scans + 1).contains(&replies.len()), "{seed}: {} {scans}", replies.len());
        // Its time begins with its first item, not with the sensor's version.
        let length = records[records.len() - 1].at.duration_since(records[0].at).unwrap();
        assert!(length <= triggered.elapsed() + before + Duration::from_millis(1), "{seed}");
        // A replay needs the window, and an answer to `V`.
        assert_eq!(sink.open().window(), Some(Window::DETECTION));
        let is_version = |record: &Record| match &record.entry {
            Entry::Reply(reply) => reply.command == Some(Command::Version),
            _ => false,
        };
        assert!(records.iter().any(is_version), "{seed}");
        let values = |scan: &tokio_scip::Scan| scan.raw_values().collect::<Vec<_>>();
        let replayed: Vec<_> = sink.open().scans().map(|scan| values(&scan.unwrap())).collect();
        let kept: Vec<_> = kept.iter().map(|(_, scan)| values(scan)).collect();
        assert_eq!(replayed, kept, "{seed}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_black_box_holds_at_most_4_mib() {
    let sink = Sink::new();
    let before = Duration::MAX;
    let mut recorder = Recorder::builder().before(before).write_to(sink.clone()).unwrap();
    for number in 0..5000 {
        let scan = Scan::builder(Window::DETECTION, [500; 682]).sequence(number).build().unwrap();
        recorder.record(&Ok(scan)).unwrap();
    }
    recorder.trigger();
    let progress = recorder.finish().await.unwrap();
    // The newest ones, each with its values of two bytes and 128 bytes besides.
    let held = (4 << 20) / (2 * 682 + 128);
    assert_eq!((progress.scans, progress.lost), (held, 0));
    let numbers: Vec<_> = sink.records().iter().map(|record| record.sequence).collect();
    assert!(numbers.into_iter().eq(5000 - held as u32..5000));
}
