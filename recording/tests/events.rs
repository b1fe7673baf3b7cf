//! Gaps in a stream, in its recording, and in the replay.

use std::time::Duration;

use tokio::time::{Instant, sleep};
use tokio_scip::{Error, ErrorKind, Rate, Scan, Sensor, Window};
use urg_recording::{Entry, Event, Events, Recorder, ReplayPace};

use super::sink::{Sink, events, observed, polls, replayed, sensor, values};

#[tokio::test(start_paused = true)]
async fn a_recording_has_both_gaps_of_a_sensor_unplugged_twice() {
    let sink = Sink::new();
    let emulator = sensor();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let began = (Instant::now(), std::time::SystemTime::now());
    let (sensor, mut scans) =
        observed(&recorder, emulator.clone(), Window::DETECTION, Rate::hz(10.0)).await;
    recorder.describe(&sensor, &scans).await.unwrap();
    let cable = tokio::spawn(async move {
        for (plugged, unplugged) in [(120, 30), (200, 5)] {
            sleep(Duration::from_secs(plugged)).await;
            emulator.unplug();
            sleep(Duration::from_secs(unplugged)).await;
            emulator.plug_in();
        }
    });
    let mut delivered = Vec::new();
    while began.0.elapsed() < Duration::from_secs(600) {
        let item = scans.next().await.unwrap();
        recorder.record(&item).unwrap();
        delivered.extend(item.map(|scan| scan.raw_values().collect::<Vec<_>>()).ok());
    }
    cable.await.unwrap();
    assert_eq!(recorder.progress().lost, 0);
    recorder.finish().await.unwrap();
    assert!(delivered.len() > 5_600, "{} scans", delivered.len());

    let records = sink.records();
    // The recorder was built a moment before `began`.
    let since =
        |at: std::time::SystemTime| at.duration_since(began.1).unwrap_or_default().as_secs_f64();
    let scans = records.iter().filter(|record| matches!(record.entry, Entry::Scan(_)));
    let times: Vec<f64> = scans.map(|record| since(record.at)).collect();
    assert_eq!(times.len(), delivered.len());
    let gaps: Vec<_> = times.windows(2).filter(|pair| pair[1] - pair[0] > 1.0).collect();
    assert_eq!(gaps.len(), 2, "{gaps:?}");
    for (gap, (from, to)) in gaps.iter().zip([(120.0, 150.0), (350.0, 355.0)]) {
        assert!((gap[0] - from).abs() < 1.0 && (gap[1] - to).abs() < 3.0, "{gap:?}");
    }
    let events = events(&records);
    assert!(
        matches!(
            events[..],
            [
                Event::Disconnected { .. },
                Event::Reconnected,
                Event::Disconnected { .. },
                Event::Reconnected
            ]
        ),
        "{events:?}"
    );

    // A replay delivers all scans again.
    let replayed = values(&replayed(sink.open(), Window::DETECTION).await);
    assert_eq!(replayed.len(), delivered.len());
    assert!(replayed == delivered, "other values");
}

#[tokio::test(start_paused = true)]
async fn a_replay_has_the_recorded_gap() {
    let sink = Sink::new();
    let emulator = sensor();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let (_sensor, mut scans) =
        observed(&recorder, emulator.clone(), Window::DETECTION, Rate::hz(10.0)).await;
    for n in 0..40 {
        if n == 20 {
            emulator.unplug();
            sleep(Duration::from_secs(20)).await;
            emulator.plug_in();
        }
        recorder.record(&scans.next().await.unwrap()).unwrap();
    }
    recorder.finish().await.unwrap();

    let replay = sink.open().replay(ReplayPace::Recorded).unwrap();
    let sensor = Sensor::builder().depth(64).connect(replay).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let (mut times, mut errors) = (Vec::new(), Vec::new());
    while let Some(item) = scans.next().await {
        match item {
            Ok(scan) => times.push(scan.received_at()),
            Err(error) => errors.push(error),
        }
    }
    let gaps: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(gaps[18] > Duration::from_secs(19) || gaps[19] > Duration::from_secs(19), "{gaps:?}");
    assert_eq!(gaps.iter().filter(|gap| **gap > Duration::from_secs(1)).count(), 1);
    // The polls in the gap timed out, which is reported once.
    let [error] = &errors[..] else { panic!("{errors:?}") };
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn missed_scans_have_an_event_and_replies() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().on_reply(recorder.observer()).connect(sensor()).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    recorder.record(&scans.next().await.unwrap()).unwrap();
    sleep(Duration::from_secs(1)).await;
    let item = scans.next().await.unwrap();
    recorder.record(&item).unwrap();
    recorder.finish().await.unwrap();
    let missed = item.unwrap().sequence() - 1;
    let records = sink.records();
    assert_eq!(events(&records), [Event::Missed { scans: missed }]);
    assert!(polls(&records).len() as u64 >= missed + 2);
}

#[tokio::test(start_paused = true)]
async fn two_streams_miss_nothing_of_each_other() {
    let sink = Sink::new();
    let mut recorder = Recorder::builder().write_to(sink.clone()).unwrap();
    let sensor = Sensor::builder().depth(100).connect(sensor()).await.unwrap();
    let (fast, slow) = (Rate::hz(5.0), Rate::hz(2.0));
    let mut streams = Vec::new();
    for (window, rate) in
        [(Window::DETECTION, fast), (Window::DETECTION, slow), (Window::FULL, slow)]
    {
        streams.push(sensor.scans(window, rate).await.unwrap());
    }
    for _ in 0..10 {
        for stream in &mut streams {
            recorder.record(&stream.next().await.unwrap()).unwrap();
            while let Some(item) = futures::FutureExt::now_or_never(stream.next()) {
                recorder.record(&item.unwrap()).unwrap();
            }
        }
    }
    recorder.finish().await.unwrap();
    assert_eq!(events(&sink.records()), []);
}

#[test]
fn events_stand_before_the_scan_that_follows_them() {
    let scan = |sequence| {
        let values = vec![0; Window::DETECTION.points()];
        Ok(Scan::builder(Window::DETECTION, values).sequence(sequence).build().unwrap())
    };
    let lost = || Error::from(ErrorKind::Disconnected { source: None });
    let closed = || Error::from(ErrorKind::Closed);
    let mut events = Events::new();
    let mut of = |item| events.from_item(&item).collect::<Vec<_>>();
    assert_eq!(of(scan(7)), []); // a stream of which no scan was read misses none
    assert_eq!(of(scan(8)), []);
    assert_eq!(of(scan(11)), [Event::Missed { scans: 2 }]);
    assert_eq!(of(Err(closed())), [Event::from(&closed())]);
    assert_eq!(of(scan(12)), []);
    assert_eq!(of(Err(lost())), [Event::Disconnected { error: lost().to_string() }]);
    assert_eq!(of(Err(closed())), [Event::Error { error: closed().to_string() }]);
    assert_eq!(of(scan(14)), [Event::Reconnected, Event::Missed { scans: 1 }]);
    assert_eq!(of(scan(15)), []);
    // Scans of another stream, and of the first one again, show no gap.
    assert_eq!((of(scan(0)), of(scan(1)), of(scan(16))), (vec![], vec![], vec![]));
}

#[test]
fn a_text_of_no_known_event_is_kept() {
    for text in [
        "",
        "{}",
        r#"{"event":"reconnected"}}"#,
        r#"{"event":"rebooted"}"#,
        r#"{"event":"missed","scans":-1}"#,
        r#"{"event":"missed","scans":1,"since":2}"#,
        r#"{"event":"error","error":"}"#,
    ] {
        assert_eq!(Event::from(text), Event::Unknown { text: text.to_owned() });
        assert_eq!(Event::from(text).to_string(), text);
    }
}
