//! The driver sleeps while a reply trickles in, where the port can suspend its wake-ups:
//! on the paused clock, with a port in memory that delivers each reply in pieces and
//! counts how often it wakes the driver.

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::time::{Instant, Sleep, sleep_until, timeout};
use tokio_scip::port::PortHints;
use tokio_scip::protocol::MalformedError;
use tokio_scip::{Error, ErrorKind, Rate, ScanStream, Sensor, State, Window};

use crate::common::instant_sensor::reply;
use crate::common::random::{Random, seeds};
use crate::common::test_port::{FarEnd, TestPort};
use crate::common::{ConnectFn, builder, ms};

/// Way in which the next scans arrive.
#[derive(Debug, Clone, Copy)]
struct Pieces {
    /// Time until the first piece.
    latency: Duration,
    length: usize,
    /// Time from piece to piece.
    interval: Duration,
    /// How long an adapter holds back the last piece, if it is not full.
    held_back: Duration,
}

/// 115,200 baud, and a UART that interrupts every 14 bytes: 122 ms a scan.
const RS232: Pieces = Pieces {
    latency: Duration::ZERO,
    length: 14,
    interval: Duration::from_micros(1215),
    held_back: Duration::ZERO,
};
/// Line at 115,200 baud, and an adapter with packets of 62 bytes.
const ADAPTER: Pieces = Pieces { length: 62, interval: Duration::from_micros(5382), ..RS232 };
/// 375 kB/s in packets of 64 bytes: 3.7 ms a scan.
const USB: Pieces = Pieces { length: 64, interval: Duration::from_micros(171), ..RS232 };

/// State that the tests and the port share.
struct Shared {
    pieces: Pieces,
    /// Changes the bytes of the next scans.
    alter: fn(&mut Vec<u8>),
    can_suspend: bool,
    /// Number of reads that brought bytes.
    reads: u64,
    /// Time of the last byte of the latest scan.
    end: Instant,
    /// Times of the last bytes of all scans.
    ends: Vec<Instant>,
    /// Time at which the line is pulled.
    pulled: Option<Instant>,
    suspended: bool,
}

/// A port whose sensor is in memory.
struct Trickle {
    shared: Arc<Mutex<Shared>>,
    command: Vec<u8>,
    coming: VecDeque<(Instant, Vec<u8>)>,
    wake: Option<Pin<Box<Sleep>>>,
}

struct Rig {
    shared: Arc<Mutex<Shared>>,
    sensor: Sensor,
    stream: ScanStream,
}

/// Opens a sensor whose scans arrive in `pieces`, five times a second.
async fn rig(pieces: Pieces, can_suspend: bool) -> Rig {
    let (shared, sensor) = open(pieces, can_suspend).await;
    let stream = sensor.scans(Window::DETECTION, Rate::hz(5.0)).await.unwrap();
    Rig { shared, sensor, stream }
}

async fn open(pieces: Pieces, can_suspend: bool) -> (Arc<Mutex<Shared>>, Sensor) {
    let shared = Arc::new(Mutex::new(Shared {
        pieces,
        alter: |_| {},
        can_suspend,
        reads: 0,
        end: Instant::now(),
        ends: Vec::new(),
        pulled: None,
        suspended: false,
    }));
    let ports = Arc::clone(&shared);
    let connect = move || {
        let shared = Arc::clone(&ports);
        let (command, coming) = (Vec::new(), VecDeque::new());
        Ok(TestPort(Trickle { shared, command, coming, wake: None }))
    };
    let sensor = builder().reconnect(false).connect(ConnectFn(connect)).await.unwrap();
    (shared, sensor)
}

impl Rig {
    /// Receives a scan, and returns the number of reads that it took, and how long after
    /// its last byte it came.
    async fn scan(&mut self) -> Result<(u64, Duration), Error> {
        let before = self.shared.lock().unwrap().reads;
        let scan = self.stream.next().await.unwrap()?;
        let shared = self.shared.lock().unwrap();
        assert_eq!(scan.len(), 682);
        Ok((shared.reads - before, scan.received_at() - shared.end))
    }

    /// Receives scans until the driver has measured enough to pause.
    async fn learn(&mut self) {
        for _ in 0..4 {
            self.scan().await.unwrap();
        }
    }

    fn set(&self, change: impl FnOnce(&mut Shared)) {
        change(&mut self.shared.lock().unwrap());
    }
}

impl Trickle {
    fn answer(&mut self) {
        let mut shared = self.shared.lock().unwrap();
        let mut bytes = Vec::new();
        reply(&self.command, &mut bytes);
        self.command.clear();
        let mut at = Instant::now();
        if !bytes.starts_with(b"G") {
            self.coming.push_back((at, bytes));
            return;
        }
        (shared.alter)(&mut bytes);
        let Pieces { latency, length, interval, held_back } = shared.pieces;
        at += latency;
        for piece in bytes.chunks(length) {
            at += interval.mul_f64(piece.len() as f64 / length as f64);
            if piece.len() < length {
                at += held_back;
            }
            self.coming.push_back((at, piece.to_vec()));
        }
        shared.end = at;
        shared.ends.push(at);
    }
}

impl PortHints for Trickle {
    fn suspend_wakeups(&mut self) -> bool {
        let mut shared = self.shared.lock().unwrap();
        shared.suspended = shared.can_suspend;
        if shared.suspended {
            self.wake = None;
        }
        shared.suspended
    }
}

impl FarEnd for Trickle {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = &mut *self;
        loop {
            let now = Instant::now();
            let mut shared = this.shared.lock().unwrap();
            shared.suspended = false;
            if shared.pulled.is_some_and(|pulled| pulled <= now) {
                return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
            }
            let before = buffer.filled().len();
            while this.coming.front().is_some_and(|(at, _)| *at <= now) {
                buffer.put_slice(&this.coming.pop_front().unwrap().1);
            }
            if buffer.filled().len() > before {
                shared.reads += 1;
                return Poll::Ready(Ok(()));
            }
            let pulled = shared.pulled;
            drop(shared);
            let next = this.coming.front().map(|(at, _)| *at);
            // Without a next piece a far time: a new command wakes the driver anyhow.
            let next = next.into_iter().chain(pulled).min().unwrap_or(now + ms(1 << 30));
            let wake = this.wake.get_or_insert_with(|| Box::pin(sleep_until(next)));
            if wake.deadline() != next {
                wake.as_mut().reset(next);
            }
            ready!(wake.as_mut().poll(cx));
        }
    }

    fn write(&mut self, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        for &byte in bytes {
            match byte {
                b'\n' if self.command.is_empty() => {}
                b'\n' => self.answer(),
                _ => self.command.push(byte),
            }
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_takes_a_few_prompt_reads() {
    for (pieces, each_piece, most) in [(RS232, 100, 4), (ADAPTER, 23, 3), (USB, 4, 4)] {
        let mut rig = rig(pieces, true).await;
        for _ in 0..3 {
            let (reads, _) = rig.scan().await.unwrap();
            assert!(reads >= each_piece, "{reads} reads: it is not measured");
        }
        for _ in 0..40 {
            let (reads, late) = rig.scan().await.unwrap();
            assert!(reads <= most, "{reads} reads of pieces of {}", pieces.length);
            // The port's own timer counts whole milliseconds.
            assert!(late <= ms(1), "{late:?} after the last byte of pieces of {}", pieces.length);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_port_without_suspension_is_read_piecewise() {
    let mut rig = rig(RS232, false).await;
    for _ in 0..10 {
        let (reads, late) = rig.scan().await.unwrap();
        assert!(reads >= 99 && late <= ms(1), "{reads} reads, {late:?} late");
    }
}

/// Fewer than five pieces after the first are not worth a pause.
#[tokio::test(start_paused = true)]
async fn scans_in_few_pieces_are_read_piecewise() {
    for (length, pieces, has_pauses) in [(275, 6, true), (290, 5, false), (375, 4, false)] {
        let mut rig = rig(Pieces { length, interval: ms(20), ..RS232 }, true).await;
        rig.learn().await;
        let (reads, _) = rig.scan().await.unwrap();
        assert_eq!(reads < pieces, has_pauses, "{length}: {reads}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_slow_pace_is_corrected_in_five_scans() {
    let mut rig = rig(RS232, true).await;
    rig.learn().await;
    rig.set(|shared| shared.pieces = USB);
    for _ in 0..5 {
        let (_, late) = rig.scan().await.unwrap();
        assert!(late <= ms(122), "{late:?}");
    }
    for _ in 0..40 {
        let (_, late) = rig.scan().await.unwrap();
        assert!(late <= ms(1), "{late:?} after the last byte");
    }
}

#[tokio::test(start_paused = true)]
async fn a_pace_that_is_too_fast_is_forgotten() {
    let mut rig = rig(USB, true).await;
    rig.learn().await;
    rig.set(|shared| shared.pieces = RS232);
    let mut reads = Vec::new();
    for _ in 0..30 {
        let (count, late) = rig.scan().await.unwrap();
        assert!(late <= ms(1), "{late:?} after the last byte");
        reads.push(count);
    }
    assert!(reads[..7].iter().all(|reads| *reads > 90), "{reads:?}");
    assert!(reads[10..].iter().all(|reads| *reads <= 4), "{reads:?}");
}

#[tokio::test(start_paused = true)]
async fn a_short_reply_is_judged_in_time() {
    let mut rig = rig(RS232, true).await;
    rig.learn().await;
    // The first ten lines, and an early end.
    rig.set(|shared| {
        shared.alter = |bytes| {
            bytes.truncate(662);
            bytes.push(b'\n');
        }
    });
    let asked = Instant::now();
    let error = rig.scan().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "{error}");
    assert!(asked.elapsed() <= ms(200 + 122), "{:?}", asked.elapsed());
    rig.set(|shared| shared.alter = |_| {});
    rig.scan().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_refusal_is_reported_at_once() {
    let mut rig = rig(RS232, true).await;
    rig.learn().await;
    rig.set(|shared| {
        shared.alter = |bytes| {
            bytes[10] = b'9';
            bytes.truncate(12);
            bytes.push(b'\n');
        }
    });
    let error = rig.scan().await.unwrap_err();
    let now = Instant::now();
    assert!(
        matches!(error.kind(), ErrorKind::Refused { .. } | ErrorKind::NotConfirmed { .. }),
        "{error}"
    );
    // A second `G` follows, after the laser was switched on.
    assert!(now - rig.shared.lock().unwrap().end <= ms(1));
}

#[tokio::test(start_paused = true)]
async fn a_longer_reply_is_read_to_its_end_and_rejected() {
    let mut rig = rig(RS232, true).await;
    rig.learn().await;
    rig.set(|shared| {
        shared.alter = |bytes| {
            bytes.splice(64..64, [b'0'; 100]);
        }
    });
    let error = rig.scan().await.unwrap_err();
    let late = Instant::now() - rig.shared.lock().unwrap().end;
    assert!(
        matches!(
            error.kind(),
            ErrorKind::Malformed { source: MalformedError::LineLength { .. }, .. }
        ),
        "{error:?}"
    );
    assert!(late <= ms(1), "{late:?} after the last byte");
    rig.set(|shared| shared.alter = |_| {});
    rig.scan().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_line_pulled_in_a_pause_is_noticed() {
    let mut rig = rig(RS232, true).await;
    rig.learn().await;
    let asked = Instant::now() + ms(200) - ms(122);
    rig.set(|shared| shared.pulled = Some(asked + ms(60)));
    let error = rig.scan().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error}");
    assert!(Instant::now() - asked <= ms(123), "{:?}", Instant::now() - asked);
    assert!(matches!(rig.sensor.watch_state().get(), State::Closed { .. }));
}

#[tokio::test(start_paused = true)]
async fn a_deadline_during_a_pause_passes_in_time() {
    // 474 ms of the 500 that a sensor without a baud rate has.
    let slow = Pieces { interval: ms(21), ..ADAPTER };
    let mut rig = rig(slow, true).await;
    rig.learn().await;
    rig.set(|shared| shared.pieces.latency = ms(100));
    let polls = rig.sensor.stats().polls;
    let error = rig.scan().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
    // The end of the scan would have come 74 ms after the deadline.
    let end = rig.shared.lock().unwrap().end;
    assert_eq!(rig.sensor.stats().polls, polls + 1);
    let early = end - Instant::now();
    assert!((ms(73)..ms(75)).contains(&early), "{early:?}");
}

#[tokio::test(start_paused = true)]
async fn a_scan_whole_at_the_deadline_counts() {
    let slow = Pieces { interval: ms(21), ..ADAPTER };
    let mut rig = rig(slow, true).await;
    rig.learn().await;
    // The reply is a little faster, and later: it ends before the deadline, the pause would not.
    rig.set(|shared| {
        shared.pieces = Pieces { latency: ms(60), interval: ms(19), ..ADAPTER };
    });
    rig.scan().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_driver_that_is_dropped_or_closed_during_a_pause_ends() {
    for close in [false, true] {
        let Rig { shared, sensor, mut stream } = rig(RS232, true).await;
        for _ in 0..4 {
            stream.next().await.unwrap().unwrap();
        }
        // 60 ms into the next scan.
        tokio::time::sleep(ms(200 - 122 + 60)).await;
        assert!(shared.lock().unwrap().suspended, "not in a pause");
        if close {
            timeout(ms(70), sensor.close()).await.unwrap();
        } else {
            drop((sensor, stream));
            timeout(ms(130), async {
                while Arc::strong_count(&shared) > 1 {
                    tokio::time::sleep(ms(1)).await;
                }
            })
            .await
            .unwrap();
        }
    }
}

/// A line and what is polled over it.
#[derive(Debug)]
struct Mix {
    pieces: Pieces,
    /// Each stream begins when the one before it has had ten scans.
    polled: Vec<(Window, Rate)>,
}

impl Mix {
    /// Draws one that leaves the line free for a third of the time.
    fn draw(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut pick = |choices: &[f64]| *random.pick(choices);
        let length = pick(&[14.0, 62.0, 64.0]);
        let bytes_per_second = pick(&[3_840.0, 11_520.0, 11_520.0, 375_000.0]);
        let held_back = pick(&[0.0, 0.001, 0.004, 0.016, 0.016]);
        let pieces = Pieces {
            latency: Duration::ZERO,
            length: length as usize,
            interval: Duration::from_secs_f64(length / bytes_per_second),
            held_back: Duration::from_secs_f64(held_back),
        };
        let count = pick(&[1.0, 2.0, 2.0, 3.0]);
        let polled = (0..count as u16).map(|_| {
            let points = pick(&[150.0, 200.0, 330.0, 500.0, 682.0]);
            let most = 0.66 / count / (points * 2.1 / bytes_per_second + held_back);
            let rate = Rate::hz(pick(&[0.02, 0.1, 0.3, 1.0]) * most.min(8.0));
            (Window::new(44..=43 + points as u16).unwrap(), rate)
        });
        Self { pieces, polled: polled.collect() }
    }

    /// Returns the median delay of the scans of each stream after its first 20.
    async fn delays(&self, can_suspend: bool) -> Vec<Duration> {
        let (shared, sensor) = open(self.pieces, can_suspend).await;
        let mut streams = Vec::new();
        for (window, rate) in &self.polled {
            let shared = Arc::clone(&shared);
            let mut stream = sensor.scans(*window, *rate).await.unwrap();
            for _ in 0..10 {
                stream.next().await.unwrap().unwrap();
            }
            streams.push(tokio::spawn(async move {
                let mut delays = Vec::new();
                for _ in 0..20 + 21 {
                    let received = stream.next().await.unwrap().unwrap().received_at();
                    let ends = &shared.lock().unwrap().ends;
                    let end = ends.iter().rev().find(|end| **end <= received).unwrap();
                    delays.push(received - *end);
                }
                let late = &mut delays[20..];
                late.sort();
                (late[10], stream)
            }));
        }
        // Each stream lasts until all have their scans.
        let mut ended = Vec::new();
        for stream in streams {
            ended.push(stream.await.unwrap());
        }
        ended.into_iter().map(|(median, _)| median).collect()
    }
}

#[tokio::test(start_paused = true)]
async fn pauses_delay_no_mix_of_windows_on_any_line() {
    for seed in seeds("SCIP_LINES", 4) {
        let mix = Mix::draw(seed);
        let with = mix.delays(true).await;
        let without = mix.delays(false).await;
        for (with, without) in with.iter().zip(&without) {
            assert!(*with <= *without + ms(1), "seed {seed}: {with:?}, not {without:?}: {mix:?}");
        }
    }
}
