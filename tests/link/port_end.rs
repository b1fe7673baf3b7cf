//! A port that has ended permanently ends the driver, whatever the driver is doing.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::task::{Context, Poll};
use std::time::Duration;

use crate::common::test_port::{FarEnd, TestPort};
use crate::common::{builder, ms, truthful};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{sleep, timeout};
use tokio_scip::port::{Connect, Port, PortHints};
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, SensorBuilder, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Link};

/// What a port that is over answers.
#[derive(Clone, Copy)]
enum End {
    Nothing,
    Failure,
}

/// An emulated sensor on ports that end together.
#[derive(Clone)]
struct Ending {
    emulator: Emulator,
    end: End,
    is_over: Arc<AtomicBool>,
    connects: Arc<AtomicU64>,
}

impl Ending {
    fn new(end: End) -> Self {
        let emulator = truthful().baud_rate(BaudRate::B115200).build();
        Self { emulator, end, is_over: Arc::default(), connects: Arc::default() }
    }
}

impl Connect for Ending {
    type Port = TestPort<EndingPort>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        self.connects.fetch_add(1, Relaxed);
        Ok(TestPort(EndingPort { link: self.emulator.link(), of: self.clone() }))
    }
}

struct EndingPort {
    link: Link,
    of: Ending,
}

impl FarEnd for EndingPort {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match (self.is_over(), self.of.end) {
            (false, _) => Pin::new(&mut self.link).poll_read(cx, buffer),
            (true, End::Nothing) => Poll::Ready(Ok(())),
            (true, End::Failure) => Poll::Ready(Err(io::ErrorKind::InvalidData.into())),
        }
    }

    fn write(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.link).poll_write(cx, bytes)
    }

    fn baud_rate(&self) -> Option<BaudRate> {
        self.link.baud_rate()
    }

    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.link.set_baud_rate(baud_rate)
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for EndingPort {
    fn is_over(&mut self) -> bool {
        self.of.is_over.load(Relaxed)
    }
}

/// Runs a driver whose port ends after `before`, and checks how the driver ends, and that it
/// opens the port `opened` times more at most.
async fn ends(builder: SensorBuilder, port: Ending, opened: u64, before: impl Future<Output = ()>) {
    let (sensor, driver) = builder.build(port.clone());
    let driver = tokio::spawn(driver);
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    before.await;
    let connects = port.connects.load(Relaxed);
    port.is_over.store(true, Relaxed);
    let outcome = timeout(Duration::from_secs(60), driver).await.unwrap().unwrap();
    let state = sensor.watch_state().get();
    let mut items = Vec::new();
    while let Some(item) = scans.next().await {
        items.extend(item.err());
    }
    match port.end {
        End::Nothing => {
            assert!(outcome.is_ok(), "{outcome:?}");
            assert!(matches!(state, State::Closed { error: None }), "{state:?}");
        }
        End::Failure => {
            let error = outcome.unwrap_err();
            assert!(
                matches!(error.kind(), ErrorKind::Disconnected { source: Some(_), .. }),
                "{error:?}"
            );
            assert!(
                matches!(items.last().unwrap().kind(), ErrorKind::Disconnected { .. }),
                "{items:?}"
            );
        }
    }
    assert!(port.connects.load(Relaxed) <= connects + opened, "it was opened again");
}

#[tokio::test(start_paused = true)]
async fn an_early_end_of_the_port_ends_the_driver() {
    for end in [End::Nothing, End::Failure] {
        ends(builder(), Ending::new(end), 1, async {}).await;
        ends(builder().wait_for_sensor(true), Ending::new(end), 1, async {}).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_port_that_ends_ends_the_search() {
    for end in [End::Nothing, End::Failure] {
        let port = Ending::new(end);
        let emulator = port.emulator.clone();
        ends(builder(), port, 0, async move {
            sleep(Duration::from_secs(5)).await;
            emulator.set_faults(Faults::none().every(Fault::Lost));
            // After three fences, and before the search has ended.
            sleep(ms(2500)).await;
        })
        .await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_port_over_at_reopening_ends_the_driver() {
    for end in [End::Nothing, End::Failure] {
        let port = Ending::new(end);
        let emulator = port.emulator.clone();
        ends(builder(), port, 1, async move {
            sleep(Duration::from_secs(5)).await;
            emulator.unplug();
            sleep(Duration::from_secs(5)).await;
        })
        .await;
    }
}
