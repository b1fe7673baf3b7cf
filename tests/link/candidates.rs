//! A connector with several candidates, one of which may have the sensor: each pass over
//! them ends, whatever the connector answers.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use crate::common::{builder, ms};
use tokio::io::DuplexStream;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_scip::port::{Connect, ConnectHints, StreamPort};
use tokio_scip::{Error, ErrorKind};

/// Always promises another candidate.
#[derive(Default)]
struct Endless {
    connects: Arc<AtomicU64>,
    /// Never connects, or connects to a port whose other end is gone.
    hangs: bool,
}

impl Connect for Endless {
    type Port = StreamPort<DuplexStream>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        self.connects.fetch_add(1, Relaxed);
        if self.hangs {
            std::future::pending::<()>().await;
        }
        Ok(StreamPort::new(tokio::io::duplex(64).0))
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        Some(self)
    }
}

impl ConnectHints for Endless {
    fn has_more(&mut self) -> bool {
        true
    }
}

#[tokio::test(start_paused = true)]
async fn opening_fails_though_the_connector_always_promises_another_candidate() {
    for open_timeout in [Duration::ZERO, ms(20), ms(5000)] {
        for hangs in [false, true] {
            let endless = Endless { hangs, ..Endless::default() };
            let opening = builder().open_timeout(open_timeout).connect(endless);
            let outcome = timeout(Duration::from_secs(600), opening).await;
            assert!(matches!(outcome, Ok(Err(_))), "{open_timeout:?}, hangs: {hangs}: {outcome:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_waiting_driver_backs_off_between_passes() {
    for hangs in [false, true] {
        let endless = Endless { hangs, ..Endless::default() };
        let connects = Arc::clone(&endless.connects);
        let builder = builder().open_timeout(Duration::ZERO).wait_for_sensor(true);
        let (_sensor, driver) = builder.build(endless);
        tokio::spawn(driver);
        sleep(Duration::from_secs(60)).await;
        let connects = connects.load(Relaxed);
        assert!((60..6000).contains(&connects), "{connects} in a minute, hangs: {hangs}");
    }
}

/// Promises another candidate until it has been tried for two seconds, as a search does that
/// retries a busy port.
#[derive(Default)]
struct Busy {
    since: Option<Instant>,
}

impl Connect for Busy {
    type Port = StreamPort<DuplexStream>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let since = *self.since.get_or_insert_with(Instant::now);
        sleep_until(since + ms(2000)).await;
        Err(ErrorKind::Busy { port: "the last one".to_owned() }.into())
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        Some(self)
    }
}

impl ConnectHints for Busy {
    fn has_more(&mut self) -> bool {
        true
    }
}

#[tokio::test(start_paused = true)]
async fn a_pass_suffices_for_a_busy_port() {
    for open_timeout in [Duration::ZERO, ms(1), ms(400)] {
        let opened = builder().open_timeout(open_timeout).connect(Busy::default()).await;
        let error = opened.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Busy { .. }), "{open_timeout:?}: {error:?}");
    }
}

/// Has no port for a while, and tells when one appears.
struct Replugged {
    appears: Instant,
    connects: Arc<AtomicU64>,
}

impl Connect for Replugged {
    type Port = StreamPort<DuplexStream>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        self.connects.fetch_add(1, Relaxed);
        Err(ErrorKind::NoSuchPort { port: "usb".to_owned() }.into())
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        Some(self)
    }
}

impl ConnectHints for Replugged {
    fn port_appears(&mut self) -> Option<Pin<Box<dyn Future<Output = ()> + Send + '_>>> {
        let is_there = Instant::now() >= self.appears;
        Some(Box::pin(async move {
            if is_there {
                return std::future::pending().await;
            }
            sleep_until(self.appears).await;
        }))
    }
}

#[tokio::test(start_paused = true)]
async fn a_port_that_appears_ends_the_back_off() {
    let (appears, connects) = (Instant::now() + ms(60_300), Arc::new(AtomicU64::new(0)));
    let replugged = Replugged { appears, connects: Arc::clone(&connects) };
    let hour = Duration::from_secs(3600);
    let builder = builder().wait_for_sensor(true).backoff(hour..=hour);
    let (_sensor, driver) = builder.build(replugged);
    tokio::spawn(driver);
    sleep_until(appears - ms(1)).await;
    assert_eq!(connects.load(Relaxed), 1);
    sleep_until(appears + ms(2)).await;
    assert_eq!(connects.load(Relaxed), 2);
}
