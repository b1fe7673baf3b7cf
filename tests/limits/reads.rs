//! Ports whose reads are interrupted, refused, out of tokio's budget, or late.

use std::collections::VecDeque;
use std::io::{self, ErrorKind::*};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::task::coop::poll_proceed;
use tokio::time::{Instant, advance, sleep};
use tokio_scip::port::PortHints;
use tokio_scip::{Error, ErrorKind, Sensor, Window};

use crate::common::instant_sensor::reply;
use crate::common::test_port::{FarEnd, TestPort};
use crate::common::{ConnectFn, builder, ms};

const WINDOW: Window = Window::DETECTION;

/// Far end of a line: what its reads return, one after another, and then the answers of a sensor.
#[derive(Default)]
struct Far {
    reads: VecDeque<Result<Vec<u8>, io::ErrorKind>>,
    answers: Vec<u8>,
    command: Vec<u8>,
    /// Error of all further reads, in place of waiting.
    refusal: Option<io::ErrorKind>,
    /// Status of all answers, in place of data.
    status: Option<u8>,
    /// True if nothing is answered.
    is_mute: bool,
    has_try_read: bool,
    /// True if it takes part in tokio's budget: without budget, no read returns bytes.
    takes_budget: bool,
    /// True if the device takes no bytes.
    holds_output: bool,
    /// Number of reads so far.
    count: usize,
}

#[derive(Clone)]
struct Line(Arc<Mutex<Far>>);

impl Line {
    fn far(&self) -> MutexGuard<'_, Far> {
        self.0.lock().unwrap()
    }

    fn next(&self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> io::Result<()> {
        let mut far = self.far();
        far.count += 1;
        if far.takes_budget {
            match poll_proceed(cx) {
                Poll::Ready(budget) => budget.made_progress(),
                Poll::Pending => return Err(WouldBlock.into()),
            }
        }
        let answers = std::mem::take(&mut far.answers);
        let next = match far.reads.pop_front() {
            Some(next) => {
                far.answers = answers;
                next
            }
            None if answers.is_empty() => Err(far.refusal.unwrap_or(WouldBlock)),
            None => Ok(answers),
        };
        next.map(|bytes| buffer.put_slice(&bytes)).map_err(io::Error::from)
    }
}

impl FarEnd for Line {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.next(cx, buffer) {
            Err(error) if error.kind() == WouldBlock && self.far().refusal.is_none() => {
                Poll::Pending
            }
            outcome => Poll::Ready(outcome),
        }
    }

    fn write(&mut self, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let far = &mut *self.far();
        for &byte in bytes {
            match byte {
                b'\n' if far.command.is_empty() || far.is_mute => far.command.clear(),
                b'\n' => {
                    match far.status {
                        Some(status) => {
                            far.answers.extend_from_slice(&far.command);
                            far.answers.extend_from_slice(&[b'\n', status, b'\n', b'\n']);
                        }
                        None => reply(&far.command, &mut far.answers),
                    }
                    far.command.clear();
                }
                _ => far.command.push(byte),
            }
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for Line {
    fn holds_output(&mut self) -> bool {
        self.far().holds_output
    }

    fn try_read(&mut self, bytes: &mut [u8]) -> Option<io::Result<usize>> {
        let mut buffer = ReadBuf::new(bytes);
        let mut cx = Context::from_waker(std::task::Waker::noop());
        let has_try_read = self.far().has_try_read;
        has_try_read.then(|| self.next(&mut cx, &mut buffer).map(|()| buffer.filled().len()))
    }
}

/// Opens a sensor on such a line, and changes the line once the driver has nothing to do.
async fn open(has_try_read: bool, change: impl FnOnce(&mut Far)) -> (Line, Sensor) {
    let line = Line(Arc::new(Mutex::new(Far { has_try_read, ..Far::default() })));
    let near = line.clone();
    let connect = ConnectFn(move || Ok(TestPort(near.clone())));
    let sensor = builder().reconnect(false).connect(connect).await.unwrap();
    sensor.scan(WINDOW).await.unwrap();
    sleep(ms(1000)).await;
    change(&mut line.far());
    (line, sensor)
}

fn io_kind(error: &Error) -> io::ErrorKind {
    let ErrorKind::Disconnected { source: Some(source), .. } = error.kind() else {
        panic!("{error:?}")
    };
    source.kind()
}

#[tokio::test(start_paused = true)]
async fn o15_pending_bytes_are_dropped_past_an_interrupted_read() {
    let pieces = [(100, 20), (20, 300)];
    for (has_try_read, (first, second)) in [true, false].into_iter().zip(pieces) {
        let piece = |length| Ok(vec![0; length]);
        let reads = [piece(first), Err(Interrupted), piece(second)].into();
        let (_line, sensor) = open(has_try_read, |far| far.reads = reads).await;
        sensor.scan(WINDOW).await.unwrap();
        assert_eq!(sensor.stats().bytes_skipped, (first + second) as u64);
        let reads = [piece(first), Err(BrokenPipe), piece(second)].into();
        let (_line, sensor) = open(has_try_read, |far| far.reads = reads).await;
        assert_eq!(io_kind(&sensor.scan(WINDOW).await.unwrap_err()), BrokenPipe);
    }
}

#[tokio::test(start_paused = true)]
async fn o15_a_port_that_is_interrupted_for_ever_blocks_nobody() {
    for has_try_read in [true, false] {
        let interrupted = |far: &mut Far| (far.refusal, far.is_mute) = (Some(Interrupted), true);
        let (_line, sensor) = open(has_try_read, interrupted).await;
        let error = sensor.scan(WINDOW).await.unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn o15_a_busy_idle_port_is_asked_rarely() {
    let (line, sensor) = open(false, |far| far.refusal = Some(WouldBlock)).await;
    sensor.scan(WINDOW).await.unwrap();
    let before = line.far().count;
    sleep(Duration::from_secs(1)).await;
    let reads = line.far().count - before;
    assert!((195..=201).contains(&reads), "{reads}");
}

#[tokio::test(start_paused = true)]
async fn an_empty_budget_is_no_quiet_line() {
    for has_try_read in [true, false] {
        // The budget is of 128 calls.
        let reads = (0..300).map(|_| Ok(vec![0])).collect();
        let change = |far: &mut Far| (far.reads, far.takes_budget) = (reads, true);
        let (_line, sensor) = open(has_try_read, change).await;
        sensor.scan(WINDOW).await.unwrap();
        assert_eq!(sensor.stats().bytes_skipped, 300);
    }
}

#[tokio::test(start_paused = true)]
async fn a_reply_that_came_while_the_program_was_stopped_is_seen() {
    // While it was idle, before the command, after it, and at the deadline, when tokio has not yet
    // asked the system.
    let quiet = [WouldBlock; 4].map(Err).into();
    let (line, sensor) = open(false, |far| far.reads = quiet).await;
    let (scan, ()) = tokio::join!(sensor.scan(WINDOW), async {
        while line.far().reads.len() > 1 {
            tokio::task::yield_now().await;
        }
        advance(Duration::from_secs(10)).await;
    });
    scan.unwrap();
    assert_eq!(sensor.stats().timeouts, 0);
}

#[tokio::test(start_paused = true)]
async fn a_copy_that_waits_in_the_port_answers_no_command() {
    let refusing = |far: &mut Far| {
        far.status = Some(b'5');
        // It comes when the idle driver has looked.
        far.reads = [Err(WouldBlock), Ok(b"L0\n0\n\n".to_vec())].into();
    };
    let (_line, sensor) = open(false, refusing).await;
    let error = sensor.laser_off().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Refused { .. }), "{error:?}");
}

#[tokio::test(start_paused = true)]
async fn a_device_that_takes_no_bytes_gets_one_fence() {
    for (holds_output, fences) in [(true, 0), (false, 6)] {
        let mute = |far: &mut Far| (far.holds_output, far.is_mute) = (holds_output, true);
        let (_line, sensor) = open(false, mute).await;
        let (began, before) = (Instant::now(), sensor.stats().fences);
        sensor.scan(WINDOW).await.unwrap_err();
        assert_eq!(sensor.stats().fences - before, fences);
        assert_eq!(began.elapsed().as_millis() / 100, 35, "it is given up as soon");
    }
}
