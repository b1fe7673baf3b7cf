//! Scans that a sensor of SCIP 2 sends on its own (`MD`): all windows and rates share them, and they
//! end with the last reader.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::FutureExt;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::scip2::Command;
use tokio_scip::{Rate, Scan, ScanStream, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Model, Values, WorldTime};

use super::{next, numbered, revolution};
use crate::common::builder;

/// Commands that begin with `head`, since the emulator was built.
fn count(emulator: &Emulator, head: &str) -> usize {
    emulator.log().iter().filter(|line| line.line.starts_with(head.as_bytes())).count()
}

/// Reads `count` scans, and returns the numbers of their revolutions.
async fn revolutions(stream: &mut ScanStream, count: usize) -> Vec<u32> {
    let mut all = Vec::new();
    for _ in 0..count {
        all.push(revolution(&next(stream).await));
    }
    all
}

fn are_consecutive(revolutions: &[u32]) -> bool {
    revolutions.windows(2).all(|pair| pair[1] == pair[0] + 1)
}

/// As after a pause of the host: some scans come late, and the next ones at once after them.
#[tokio::test(start_paused = true)]
async fn the_sensors_own_rate_has_each_scan_even_if_several_come_at_once() {
    // The emulated sensor itself drops what is later than 200 ms.
    let late = || Fault::Late(Duration::from_millis(190));
    let models = [(Model::Ust10lx, 40.0), (Model::Utm30lx, 40.0), (Model::Urg04lxUg01, 10.0)];
    for (model, hz) in models {
        let emulator = numbered(model).build();
        let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(hz)).await.unwrap();
        revolutions(&mut stream, 100).await;
        emulator.set_faults(Faults::none().up_to(0.02, late()).seed(1));
        let all = revolutions(&mut stream, 1000).await;
        let gaps: Vec<_> = all.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
        assert_eq!(gaps, [[0; 2]; 0], "{model:?}");
    }
}

/// No motor turns exactly with the grid of the polls.
#[tokio::test(start_paused = true)]
async fn a_fast_or_slow_motor_costs_a_stream_of_its_rate_no_scan() {
    for (model, nominal, hz) in
        [(Model::Ust10lx, 25_000, 40.0), (Model::Urg04lxUg01, 100_000, 10.0)]
    {
        for permille in [-4, -2, -1, 1, 2, 4] {
            let revolution = Duration::from_micros(nominal * (1000 + permille) as u64 / 1000);
            for turns in [1, 4] {
                let emulator = numbered(model).revolution(revolution).build();
                let sensor = builder().depth(2048).connect(emulator.clone()).await.unwrap();
                let rate = Rate::hz(hz / f64::from(turns));
                let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
                // The first scan may be followed by one of a stream with fewer left out.
                let all = revolutions(&mut stream, 602).await.split_off(2);
                let is_whole = all.windows(2).all(|pair| pair[1] == pair[0] + turns);
                assert!(is_whole, "{model:?}, {permille}, {turns}: {all:?}");
            }
        }
    }
}

/// A UBG-04LX-F01 says 2,400 rpm, and turns in 28 ms: every third scan is enough, and each fourth is not.
#[tokio::test(start_paused = true)]
async fn a_stream_has_its_rate_although_the_sensor_tells_another_speed() {
    for (model, micros, hz) in [
        (Model::Utm30lx, 28_000, 10.0),
        (Model::Utm30lx, 28_000, 20.0),
        (Model::Ust10lx, 28_000, 13.0),
        (Model::Urg04lxUg01, 111_000, 2.0),
        (Model::Ust10lx, 22_500, 10.0),
    ] {
        let emulator = numbered(model).revolution(Duration::from_micros(micros)).build();
        let sensor = builder().depth(64).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(hz)).await.unwrap();
        revolutions(&mut stream, 100).await;
        let (start, commands, lost) = (Instant::now(), count(&emulator, "MD"), sensor.stats().lost);
        revolutions(&mut stream, 500).await;
        let reached = 500.0 / start.elapsed().as_secs_f64();
        assert!((reached / hz - 1.0).abs() < 0.01, "{model:?} {micros} us: {reached} of {hz} Hz");
        assert_eq!(count(&emulator, "MD"), commands, "{model:?} {micros} us");
        assert_eq!(sensor.stats().lost, lost, "{model:?} {micros} us");
    }
}

/// Scans come a little before or after the points of a slow stream's grid.
#[tokio::test(start_paused = true)]
async fn a_slow_stream_beside_a_fast_one_has_every_nth_scan() {
    let models = [(Model::Urg04lxUg01, 10.0, 4), (Model::Ust10lx, 40.0, 190)];
    for (turns, (model, hz, late)) in (2..=4).flat_map(|turns| models.map(|model| (turns, model))) {
        let emulator = numbered(model).build();
        let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
        let mut fast = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut fast).await;
        revolutions(&mut fast, 100).await;
        let late = Fault::Late(Duration::from_millis(late));
        emulator.set_faults(Faults::none().up_to(if hz > 10.0 { 0.05 } else { 1.0 }, late));
        sleep(Duration::from_millis(2)).await;
        let rate = Rate::hz(hz / f64::from(turns));
        let mut slow = sensor.scans(Window::DETECTION, rate).await.unwrap();
        // The first point is due at once.
        let all = revolutions(&mut slow, 200).await.split_off(1);
        let is_whole = all.windows(2).all(|pair| pair[1] == pair[0] + turns);
        assert!(is_whole, "{model:?}, {turns}: {all:?}");
    }
}

/// The host is busiest when a program starts, before the sensor's clock is known.
#[tokio::test(start_paused = true)]
async fn a_stream_begins_with_each_scan_even_if_several_come_at_once() {
    for (model, hz) in [(Model::Ust10lx, 40.0), (Model::Urg04lxUg01, 10.0)] {
        for (seed, rate) in (0..50).flat_map(|seed| [(seed, Rate::hz(hz)), (seed, Rate::UNLIMITED)])
        {
            let emulator = numbered(model).build();
            let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
            let late = Fault::Late(Duration::from_millis(190));
            emulator.set_faults(Faults::none().up_to(0.1, late).seed(seed));
            let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
            let all = revolutions(&mut stream, 40).await;
            assert!(are_consecutive(&all), "{model:?}, seed {seed}, {rate}: {all:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn all_windows_and_rates_share_one_stream() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
    let window = |from, to| Window::degrees(from..=to).unwrap();
    let mut left = sensor.scans(window(10.0, 90.0), Rate::UNLIMITED).await.unwrap();
    let mut right = sensor.scans(window(-90.0, -10.0), Rate::UNLIMITED).await.unwrap();
    let mut slow = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut slowest = sensor.scans(Window::DETECTION, Rate::hz(0.5)).await.unwrap();
    sleep(Duration::from_secs(1)).await;
    let (streams, stopped) = (count(&emulator, "MD"), count(&emulator, "QT"));
    for stream in [&mut left, &mut right, &mut slow] {
        while stream.next().now_or_never().is_some() {}
    }
    sleep(Duration::from_secs(10)).await;
    let (left, right) = (revolutions(&mut left, 400).await, revolutions(&mut right, 400).await);
    assert_eq!(left, right);
    assert!(are_consecutive(&left), "{left:?}");
    // Ten a second, the newest each time.
    let slow = revolutions(&mut slow, 99).await;
    assert!(slow.windows(2).all(|pair| pair[1] == pair[0] + 4), "{slow:?}");
    assert_eq!(revolutions(&mut slowest, 5).await.len(), 5);
    assert_eq!((count(&emulator, "MD"), count(&emulator, "QT")), (streams, stopped));
    let stats = sensor.stats();
    assert_eq!((count(&emulator, "GD"), stats.lost, stats.polls_skipped), (0, 0, 0));
}

#[tokio::test(start_paused = true)]
async fn single_scans_and_settings_go_beside_a_stream() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    let mut singles = Vec::new();
    for _ in 0..20 {
        let asked = Instant::now();
        singles.push(sensor.scan(Window::new(100..=200).unwrap()).await.unwrap());
        assert!(asked.elapsed() <= Duration::from_millis(27), "{:?}", asked.elapsed());
    }
    assert_eq!((count(&emulator, "MD"), count(&emulator, "GD")), (1, 0));
    let all = revolutions(&mut stream, 20).await;
    assert_eq!(all, singles.iter().map(revolution).collect::<Vec<_>>());
    // The laser's command ends the stream, which begins anew.
    sensor.laser_off().await.unwrap();
    assert!(!emulator.is_laser_on());
    sensor.laser_on().await.unwrap();
    let again = revolutions(&mut stream, 20).await;
    assert!(are_consecutive(&again) && again[0] > all[19], "{again:?}");
}

#[tokio::test(start_paused = true)]
async fn a_window_outside_of_the_stream_widens_it() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().depth(512).connect(emulator.clone()).await.unwrap();
    let mut front = sensor.scans(Window::new(500..=580).unwrap(), Rate::UNLIMITED).await.unwrap();
    let before = revolutions(&mut front, 10).await;
    let single = sensor.scan(Window::new(100..=109).unwrap()).await.unwrap();
    assert_eq!(single.len(), 10);
    let after = revolutions(&mut front, 10).await;
    let lost = sensor.stats().lost;
    // The sensor sends nothing between the two streams.
    assert_eq!(u64::from(after[0] - before[9] - 1), lost);
    assert_eq!(count(&emulator, "MD"), count(&emulator, "QT"));
    assert!((1..=3).contains(&lost), "{lost}");
    assert!(are_consecutive(&after), "{after:?}");
    assert!(emulator.log().iter().any(|line| line.line.starts_with(b"MD0100058001000")));
}

#[tokio::test(start_paused = true)]
async fn a_stream_ends_with_its_last_reader() {
    for rate in [Rate::UNLIMITED, Rate::hz(10.0)] {
        let emulator = numbered(Model::Utm30lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
        next(&mut stream).await;
        let ended = count(&emulator, "QT");
        drop(stream);
        sleep(Duration::from_secs(1)).await;
        assert_eq!(count(&emulator, "QT"), ended + 1, "{rate}");
        // Like after a single scan.
        assert!(emulator.is_laser_on(), "{rate}");
        let bytes = sensor.stats().bytes_skipped;
        sleep(Duration::from_secs(1)).await;
        assert_eq!(sensor.stats().bytes_skipped, bytes, "{rate}");
        // Meanwhile no scan was wanted.
        next(&mut sensor.scans(Window::DETECTION, rate).await.unwrap()).await;
        assert_eq!(sensor.stats().lost, 0, "{rate}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stream_that_was_dropped_without_a_link_does_not_begin() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    emulator.unplug();
    let mut state = sensor.watch_state();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.map(drop).unwrap();
    drop(sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap());
    emulator.plug_in();
    state.connected().await.unwrap();
    sleep(Duration::from_secs(1)).await;
    assert_eq!(count(&emulator, "MD"), 0);
}

#[tokio::test(start_paused = true)]
async fn the_fastest_rate_sets_how_many_scans_are_sent() {
    let emulator = numbered(Model::Ust10lx).build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let mut slow = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    next(&mut slow).await;
    sensor.scan(Window::DETECTION).await.unwrap();
    assert_eq!((count(&emulator, "MD0000108001300"), count(&emulator, "MD")), (1, 1));
    let mut fast = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    assert!(are_consecutive(&revolutions(&mut fast, 40).await));
    assert_eq!(count(&emulator, "MD0000108001000"), 1);
    drop(fast);
    while next(&mut slow).now_or_never().is_some() {}
    for _ in 0..30 {
        next(&mut slow).await;
    }
    assert_eq!(count(&emulator, "MD0000108001300"), 2);
}

#[tokio::test(start_paused = true)]
async fn a_driver_that_ends_stops_its_stream() {
    for is_closed in [true, false] {
        let emulator = numbered(Model::Ust10lx).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        let ended = count(&emulator, "QT");
        if is_closed {
            sensor.close().await;
        } else {
            drop((sensor, stream));
            sleep(Duration::from_secs(1)).await;
        }
        assert_eq!(count(&emulator, "QT"), ended + 1);
        assert!(!emulator.is_laser_on());
    }
}

/// A recorder keeps the replies whose request it knows.
#[tokio::test(start_paused = true)]
async fn observers_know_the_request_of_each_scan_also_beside_another_request() {
    let emulator = numbered(Model::Ust10lx).build();
    let scans = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&scans);
    let observed = builder().depth(512).on_reply(move |reply| {
        if reply.bytes.starts_with(b"MD") && reply.bytes.len() > 1000 {
            seen.lock().unwrap().push(
                reply
                    .request
                    .is_some_and(|request| matches!(request.command(), Command::Stream(_))),
            );
        }
    });
    let sensor = observed.connect(emulator.clone()).await.unwrap();
    let window = Window::new(0..=500).unwrap();
    let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    emulator.set_faults(Faults::none().up_to(0.5, Fault::Late(Duration::from_millis(90))).seed(1));
    for n in 0..50 {
        sleep(Duration::from_millis(100 + n)).await;
        sensor.scan(Window::DETECTION).await.unwrap();
    }
    let scans = scans.lock().unwrap().clone();
    assert!(scans.len() > 50 && scans.iter().all(|is_known| *is_known), "{scans:?}");
}

/// A recorder finds the reply of each scan by its stamp. Without its last line feed, a reply runs into
/// the next one.
#[tokio::test(start_paused = true)]
async fn observers_get_the_stamp_of_each_scan_also_after_the_rest_of_another_reply() {
    for model in [Model::Ust10lx, Model::Utm30lx, Model::Urg04lxUg01] {
        let emulator = numbered(model).build();
        let stamps = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&stamps);
        let observed = builder().depth(512).on_reply(move |reply| {
            seen.lock().unwrap().push((reply.stamp, reply.bytes.len()));
        });
        let sensor = observed.connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        emulator.set_faults(Faults::none().rate(0.2, Fault::Merged).rate(0.2, Fault::Cut(100)));
        let (mut scans, mut longest) = (0, 0);
        while scans < 100 {
            let Ok(scan) = stream.next().await.unwrap() else { continue };
            let own = stamps
                .lock()
                .unwrap()
                .iter()
                .find(|(stamp, _)| *stamp == scan.times().stamp)
                .copied();
            longest = longest.max(own.unwrap_or_else(|| panic!("{model:?}, scan {scans}")).1);
            scans += 1;
        }
        let alone = stamps.lock().unwrap().last().unwrap().1;
        assert!(longest > 2 * alone, "{model:?}: {longest} bytes, {alone} alone");
        // A reply that runs into the next one takes none with it.
        let stats = sensor.stats();
        assert!(stats.lost < scans * 6 / 10 && stats.malformed.line > 30, "{model:?}: {stats:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn lost_scans_are_counted() {
    // The sensor tells 25 ms.
    for micros in [25_000, 28_000, 22_300] {
        let emulator = numbered(Model::Ust10lx).revolution(Duration::from_micros(micros)).build();
        let sensor = builder().depth(2048).connect(emulator.clone()).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let first = revolutions(&mut stream, 50).await[49];
        emulator
            .set_faults(Faults::none().rate(0.2, Fault::Damaged).rate(0.3, Fault::Lost).seed(1));
        sleep(Duration::from_secs(20)).await;
        emulator.set_faults(Faults::none());
        sleep(Duration::from_secs(1)).await;
        let (mut all, end) = (vec![first], Instant::now());
        loop {
            let Ok(scan) = stream.next().await.unwrap() else { continue };
            if scan.received_at() > end {
                break;
            }
            all.push(revolution(&scan));
        }
        let gaps: u32 = all.windows(2).map(|pair| pair[1] - pair[0] - 1).sum();
        assert!(gaps > 100, "{gaps}");
        assert_eq!(sensor.stats().lost, u64::from(gaps));
        // None is lost by a clock that jumps, or by a restart.
        for jump in [1_500, 5_000, -2_000, 20_000] {
            emulator.jump_clock(jump);
            sleep(Duration::from_secs(1)).await;
        }
        assert_eq!(sensor.stats().lost, u64::from(gaps));
    }
}

/// Between two scans of a slow stream the sensor has left out some, which no stream had asked for.
#[tokio::test(start_paused = true)]
async fn a_faster_stream_loses_no_scan_that_was_left_out() {
    for (model, hz) in [(Model::Urg04lxUg01, 10.0), (Model::Ust10lx, 40.0)] {
        for pause in (0..1000).step_by(90).map(Duration::from_millis) {
            let emulator = numbered(model).build();
            let sensor = builder().depth(512).connect(emulator).await.unwrap();
            let mut slow = sensor.scans(Window::DETECTION, Rate::hz(hz / 10.0)).await.unwrap();
            revolutions(&mut slow, 25).await;
            sleep(pause).await;
            let mut fast = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
            assert!(are_consecutive(&revolutions(&mut fast, 20).await));
            assert_eq!(sensor.stats().lost, 0, "{model:?} after {pause:?}");
        }
    }
}

/// Scan of clusters, and the same from a sensor that sends nothing on its own.
async fn clustered(model: Model, is_streaming: bool) -> Scan {
    let emulator = Emulator::builder().model(model).world(|_: WorldTime, values: &mut Values| {
        for (step, slot) in values.iter_mut().enumerate() {
            // Some are no distance.
            *slot = (step as u32 * 7919) % 3000;
            if step % 5 == 0 {
                *slot %= 3;
            }
        }
    });
    let sensor = builder().connect(emulator.build()).await.unwrap();
    let mut stream = None;
    if is_streaming {
        let scans = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(stream.insert(scans)).await;
    }
    sensor.scan(Window::new(101..=300).unwrap().with_cluster_count(7).unwrap()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn clusters_are_cut_from_a_stream_as_the_sensor_makes_them() {
    for model in [Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let (own, asked) = (clustered(model, true).await, clustered(model, false).await);
        assert_eq!(own.len(), 29);
        assert!(own.raw_values().eq(asked.raw_values()), "{model:?} {own:?} {asked:?}");
    }
}

/// Its clock is set back again and again, and reads 0.
#[tokio::test(start_paused = true)]
async fn scans_of_a_clock_that_stands_still_arrive() {
    for rate in [0.3, 1.0, 3.0, 10.0] {
        let emulator = numbered(Model::Urg04lxUg01).revolution(Duration::from_millis(110));
        let emulator = emulator.faults(Faults::none().every(Fault::ClockJump(-5000))).build();
        let sensor = builder().connect(emulator).await.unwrap();
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(rate)).await.unwrap();
        for _ in 0..10 {
            let within = Duration::from_secs_f64(4.0 / rate);
            let scan = timeout(within, next(&mut stream)).await;
            assert!(scan.is_ok(), "{rate} Hz");
        }
    }
}

/// Seeds: `SCIP_RATES=200 cargo test --test it evenly`.
#[test]
fn scans_come_evenly_at_any_rate() {
    for seed in crate::common::random::seeds("SCIP_RATES", 30) {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        runtime.enable_all().start_paused(true).build().unwrap().block_on(evenly(seed));
    }
}

async fn evenly(seed: u64) {
    let mut random = crate::common::random::Random::new(seed);
    let (model, told) = *random.pick(&[(Model::Urg04lxUg01, 100_000), (Model::Ust10lx, 25_000)]);
    let revolution = told * (997 + random.below(7)) / 1000;
    let emulator = numbered(model).revolution(Duration::from_micros(revolution)).build();
    let sensor = builder().depth(512).connect(emulator).await.unwrap();
    let count = 1 + random.below(3);
    let mut streams = Vec::new();
    for _ in 0..count {
        // A schedule of more than ten has a stream only if another has one: then both share it.
        let most = if random.once_in(4) { 4000 } else { 1000 };
        let turns = (100 + random.below(most - 100)) as f64 / 100.0;
        let rate = Rate::hz(1e6 / (turns * told as f64));
        streams.push((turns, sensor.scans(Window::DETECTION, rate).await.unwrap()));
    }
    // The sensor's own period is known by then.
    sleep(Duration::from_secs(20)).await;
    for (turns, stream) in &mut streams {
        let mut all = revolutions(stream, 150).await.into_iter().skip(100);
        let mut latest = all.next().unwrap();
        for now in all {
            // The number begins anew after 3,000.
            let off = (f64::from((now + 3000 - latest) % 3000) - *turns).abs();
            // Several share the scans, so a period may be two of the sensor's.
            let most = *turns / if count == 1 { 4.0 } else { 2.0 };
            assert!(off <= most.max(1.0) + 0.1, "seed {seed}: {off} of {turns}, {model:?}");
            latest = now;
        }
    }
}
