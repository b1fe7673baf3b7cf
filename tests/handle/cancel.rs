//! Dropping any future at any await loses nothing and disturbs no other request.

use std::future::{Future, IntoFuture, poll_fn};
use std::pin::pin;
use std::task::Poll;

use futures::FutureExt;

use crate::common::{builder, ms, truthful};
use tokio_scip::{BaudRate, Driver, ErrorKind, Rate, Sensor, Window};
use urg_emulator::{Emulator, Model, Verdict};

/// Runs the driver step by step, and drops `future` after `steps` of them. Returns whether it had
/// finished by then.
async fn drop_after<F: Future>(
    driver: &mut std::pin::Pin<&mut Driver>,
    future: F,
    steps: usize,
) -> bool {
    let mut future = pin!(future);
    let mut left = steps;
    poll_fn(|cx| {
        if future.as_mut().poll(cx).is_ready() {
            return Poll::Ready(true);
        }
        if left == 0 {
            return Poll::Ready(false);
        }
        left -= 1;
        assert!(driver.as_mut().poll(cx).is_pending());
        Poll::Pending
    })
    .await
}

/// Drops the future that `ask` makes after every number of steps, and requests a scan
/// after each. Returns how many steps the future takes to finish.
async fn dropped_at_every_step<F: Future>(ask: impl Fn(Sensor) -> F) -> usize {
    for steps in 0.. {
        let emulator = truthful().baud_rate(BaudRate::B19200).build();
        let (sensor, driver) = builder().build(emulator.clone());
        let mut driver = pin!(driver);
        let mut state = sensor.watch_state();
        let opened = pin!(state.connected());
        assert!(with(&mut driver, opened).await.is_ok());

        let finished = drop_after(&mut driver, ask(sensor.clone()), steps).await;

        let window = Window::new(100..=110).unwrap();
        let scan = with(&mut driver, pin!(sensor.scan(window))).await;
        // After laser_off the scan fails with LaserOff.
        if emulator.is_laser_on() {
            assert_eq!(scan.unwrap().len(), 11, "dropped after {steps} steps");
        }
        with(&mut driver, pin!(sensor.version())).await.unwrap();
        check_line(&emulator);
        if finished {
            return steps;
        }
    }
    unreachable!()
}

/// Runs the driver until `future` has finished.
async fn with<F: Future>(
    driver: &mut std::pin::Pin<&mut Driver>,
    mut future: std::pin::Pin<&mut F>,
) -> F::Output {
    poll_fn(|cx| {
        if let Poll::Ready(output) = future.as_mut().poll(cx) {
            return Poll::Ready(output);
        }
        assert!(driver.as_mut().poll(cx).is_pending());
        future.as_mut().poll(cx)
    })
    .await
}

/// Asserts that the sensor received only whole commands, one at a time.
fn check_line(emulator: &Emulator) {
    assert_eq!((emulator.counts().malformed, emulator.counts().overlapping), (0, 0));
    assert!(emulator.log().iter().all(|line| line.garbled || line.verdict != Verdict::Malformed));
}

#[tokio::test(start_paused = true)]
async fn a01_a_scan_dropped_at_every_await() {
    let steps = dropped_at_every_step(|sensor| async move {
        sensor.scan(Window::DETECTION).await.unwrap();
    });
    assert!(steps.await > 3);
}

#[tokio::test(start_paused = true)]
async fn a01_a_stream_dropped_at_every_await() {
    let steps = dropped_at_every_step(|sensor| async move {
        let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        for _ in 0..3 {
            stream.next().await.unwrap().unwrap();
        }
    });
    assert!(steps.await > 8);
}

#[tokio::test(start_paused = true)]
async fn a01_a_stream_that_nobody_takes_is_not_polled() {
    for model in [Model::Urg04lx, Model::Ust10lx] {
        let emulator = Emulator::builder().model(model).build();
        let sensor = builder().connect(emulator.clone()).await.unwrap();
        let mut subscribing =
            Box::pin(sensor.scans(Window::DETECTION, Rate::UNLIMITED).into_future());
        assert!((&mut subscribing).now_or_never().is_none());
        // The driver answers meanwhile.
        tokio::time::sleep(ms(500)).await;
        drop(subscribing);
        tokio::time::sleep(ms(1000)).await;
        let scans = emulator.counts().scans;
        tokio::time::sleep(ms(1000)).await;
        assert_eq!(emulator.counts().scans, scans, "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a01_laser_commands_dropped_at_every_await() {
    let steps = dropped_at_every_step(|sensor| async move {
        sensor.laser_off().await.unwrap();
        sensor.laser_on().await.unwrap();
    });
    assert!(steps.await > 8);
}

#[tokio::test(start_paused = true)]
async fn a01_a_change_of_baud_rate_dropped_at_every_await() {
    let steps = dropped_at_every_step(|sensor| async move {
        sensor.set_baud_rate(BaudRate::B750000).await.unwrap();
    });
    assert!(steps.await > 8);
}

#[tokio::test(start_paused = true)]
async fn a01_a_request_dropped_in_the_queue_is_not_written() {
    let emulator = truthful().build();
    let sensor = builder().connect(emulator.clone()).await.unwrap();
    let busy = tokio::spawn({
        let sensor = sensor.clone();
        async move { sensor.scan(Window::FULL).await.map(drop) }
    });
    tokio::task::yield_now().await;
    let before = emulator.counts().commands;
    let dropped = tokio::time::timeout(ms(5), sensor.laser_off()).await;
    assert!(dropped.is_err());
    busy.await.unwrap().unwrap();
    sensor.scan(Window::FULL).await.unwrap();
    assert!(emulator.is_laser_on());
    assert!(emulator.log().iter().all(|line| line.line != b"L0"));
    assert!(emulator.counts().commands > before);
}

#[tokio::test(start_paused = true)]
async fn a05_a_dropped_driver_ends_handles_and_streams() {
    for steps in 0..40 {
        let emulator = truthful().build();
        let (sensor, driver) = builder().build(emulator.clone());
        let work = tokio::spawn({
            let sensor = sensor.clone();
            async move {
                let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await?;
                while let Some(item) = stream.next().await {
                    item?;
                }
                Ok::<(), tokio_scip::Error>(())
            }
        });
        {
            let mut driver = pin!(driver);
            let mut left = steps;
            poll_fn(|cx| {
                assert!(driver.as_mut().poll(cx).is_pending());
                left -= 1;
                if left < 0 { Poll::Ready(()) } else { Poll::Pending }
            })
            .await;
        }
        let error = work.await.unwrap().unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Closed), "{error:?}");
        assert!(matches!(sensor.version().await.unwrap_err().kind(), ErrorKind::Closed));
        assert!(!emulator.is_connected());
    }
}

#[tokio::test(start_paused = true)]
async fn a_driver_that_never_runs_ends_every_call() {
    let (sensor, driver) = builder().build(truthful().build());
    let asked = tokio::spawn({
        let sensor = sensor.clone();
        async move { sensor.scan(Window::FULL).await.map(drop) }
    });
    let opened = tokio::spawn({
        let sensor = sensor.clone();
        async move { sensor.watch_state().connected().await }
    });
    tokio::task::yield_now().await;
    drop(driver);
    for answer in [asked, opened] {
        let answer = tokio::time::timeout(ms(60_000), answer).await;
        assert!(matches!(answer.unwrap().unwrap().unwrap_err().kind(), ErrorKind::Closed));
    }
    sensor.close().await;
}
