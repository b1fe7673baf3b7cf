//! Wake-ups, system calls, CPU time and latency of scans that arrive in pieces, as over a
//! serial line, at the rate of a real sensor: on a pseudo-terminal, with the sensor in another
//! process. The driver is compared with itself without pauses, with a floor, which only writes
//! a command and reads, blocking, until the reply has ended, and with the same loop on tokio
//! and tokio-serial, with a deadline.
//!
//! `cargo bench --bench pieces` prints a table, `-- usb 5 60` a table of one pattern, with five
//! rounds of 60 scans for each poller. strace counts the system calls. With the arguments of one poller (`floor`, `tokio`,
//! `driver` or `unpaused`), one pattern (the first column) and a number of
//! scans it runs only these, for `strace` and `.ci/system_calls`. With `serve` and a pattern it
//! plays the sensor for another program, and prints the path of its terminal.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::io::{self, Read, Write};
use std::path::Path;
use std::pin::Pin;
use std::process::{Command, Stdio};
use std::task::{Context, Poll};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use support::server::Server;
use support::{cpu_time, median, percentile, terminal, us, wake_ups};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::runtime::Builder;
use tokio::time::{sleep_until, timeout};
use tokio_scip::port::{Connect, Port, PortHints};
use tokio_scip::{BaudRate, Endpoint, Error, Rate, Sensor, Window};
use tokio_serial::SerialStream;

#[path = "../tests/common/instant_sensor.rs"]
mod instant_sensor;
#[path = "support/mod.rs"]
mod support;

const ROUNDS: usize = 5;
const SCANS: usize = 30;
/// Scans before the measured ones: the driver measures the first ones itself.
const FIRST_SCANS: usize = 5;
/// Bytes of the last two points and the end of a scan.
const END_BYTES: usize = 6;
const POLLERS: [&str; 4] = ["floor", "tokio", "driver", "unpaused"];

/// A revolution of the motor of a real sensor.
const REVOLUTION: Duration = Duration::from_nanos(99_760_500);

/// How the bytes of a reply arrive.
struct Pattern {
    name: &'static str,
    /// When a reply begins.
    begins: Begins,
    /// Bytes a piece.
    piece: usize,
    /// Time from piece to piece.
    interval: Duration,
    /// Scans a second, or `None` to poll as fast as the sensor answers.
    rate: Option<u32>,
}

#[derive(Clone, Copy, PartialEq)]
enum Begins {
    AtOnce,
    /// It begins 90 ms after its command.
    Later,
    /// When the motor ends its revolution.
    WithTheMotor,
}

const PATTERNS: [Pattern; 8] = [
    // 115,200 baud: 11,520 bytes a second.
    Pattern::new("rs232", Begins::AtOnce, 14, 1_215_278, Some(5)),
    Pattern::new("adapter", Begins::AtOnce, 62, 5_381_944, Some(5)),
    // 375 kB a second.
    Pattern::new("usb", Begins::AtOnce, 64, 170_667, Some(10)),
    Pattern::new("usb-phase", Begins::Later, 64, 170_667, Some(10)),
    // A URG sends frames of 375 bytes, one each millisecond.
    Pattern::new("frames", Begins::WithTheMotor, 375, 1_000_000, Some(10)),
    Pattern::new("frames-max", Begins::WithTheMotor, 375, 1_000_000, None),
    Pattern::new("whole", Begins::AtOnce, 4096, 170_667, Some(10)),
    Pattern::new("whole-max", Begins::AtOnce, 4096, 0, None),
];

impl Pattern {
    const fn new(
        name: &'static str,
        begins: Begins,
        piece: usize,
        interval: u64,
        rate: Option<u32>,
    ) -> Self {
        Self { name, begins, piece, interval: Duration::from_nanos(interval), rate }
    }

    fn period(&self) -> Option<Duration> {
        self.rate.map(|rate| Duration::from_secs(1) / rate)
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let pattern = |name| PATTERNS.iter().find(|pattern| pattern.name == name).unwrap();
    match arguments[..] {
        ["serve", name] => serve(pattern(name)),
        [name, rounds, scans] if !POLLERS.contains(&name) => {
            println!("{HEADER}");
            table(pattern(name), rounds.parse().unwrap(), scans.parse().unwrap());
        }
        [poller, name, scans] => {
            let server = Server::start(name);
            let cost = poll(poller, &server.path, pattern(name), scans.parse().unwrap());
            println!("{:.1} wake-ups, {:.0} us", cost.wake_ups(), cost.cpu());
        }
        _ => {
            println!("{HEADER}");
            PATTERNS.iter().for_each(|pattern| table(pattern, ROUNDS, SCANS));
        }
    }
}

const HEADER: &str = "pattern     poller    wake-ups/scan  calls/scan  CPU us/scan  of floor  of tokio  latency us: median    99 %";

/// Prints the medians of some rounds of each poller.
fn table(pattern: &Pattern, rounds: usize, scans: usize) {
    let server = Server::start(pattern.name);
    // They run side by side in each round: a load that disturbs one disturbs all.
    let rounds: Vec<[Cost; 4]> = (0..rounds)
        .map(|_| POLLERS.map(|poller| poll(poller, &server.path, pattern, scans)))
        .collect();
    for (index, poller) in POLLERS.into_iter().enumerate() {
        let of = |figure: fn(&Cost) -> f64| median(rounds.iter().map(|r| figure(&r[index])));
        let to = |other: usize| median(rounds.iter().map(|r| r[index].cpu() / r[other].cpu()));
        let mut latencies: Vec<Duration> =
            rounds.iter().flat_map(|round| round[index].latencies.clone()).collect();
        let calls = calls(poller, pattern).map_or("-".to_owned(), |calls| format!("{calls:.1}"));
        println!(
            "{:10}  {poller:8}  {:13.1}  {calls:>10}  {:11.0}  {:8.2}  {:8.2}  {:18.0}  {:6.0}",
            pattern.name,
            of(Cost::wake_ups),
            of(Cost::cpu),
            to(0),
            to(1),
            us(percentile(&mut latencies, 0.5)),
            us(percentile(&mut latencies, 0.99)),
        );
    }
}

/// Returns the system calls a scan of the thread that polls, or `None` without strace. Counts the
/// difference of two runs: the start of the program is in both.
fn calls(poller: &str, pattern: &Pattern) -> Option<f64> {
    let (few, many) = (10, 40);
    let count = |scans: usize| {
        let traced = Command::new("strace")
            .arg(std::env::current_exe().ok()?)
            .args([poller, pattern.name, &scans.to_string()])
            .stdout(Stdio::null())
            .output()
            .ok()?;
        let lines = traced.stderr.split(|byte| *byte == b'\n');
        Some(lines.filter(|line| line.first().is_some_and(u8::is_ascii_lowercase)).count())
    };
    Some((count(many)? as f64 - count(few)? as f64) / (many - few) as f64)
}

/// Cost of a number of scans.
#[derive(Debug)]
struct Cost {
    wake_ups: u64,
    cpu: Duration,
    /// Time from just before the last piece was written until the scan was held.
    latencies: Vec<Duration>,
}

impl Cost {
    fn wake_ups(&self) -> f64 {
        self.wake_ups as f64 / self.latencies.len() as f64
    }

    /// Returns microseconds of CPU time a scan.
    fn cpu(&self) -> f64 {
        us(self.cpu) / self.latencies.len() as f64
    }
}

fn poll(poller: &str, path: &Path, pattern: &Pattern, scans: usize) -> Cost {
    match poller {
        "floor" => floor(path, pattern, scans),
        "tokio" => bare_tokio(path, pattern, scans),
        "driver" => driver(false, path, pattern, scans),
        "unpaused" => driver(true, path, pattern, scans),
        _ => panic!("{poller}: use floor, tokio, driver or unpaused"),
    }
}

/// Polls with one write and as few reads as possible, without decoding.
fn floor(path: &Path, pattern: &Pattern, scans: usize) -> Cost {
    let mut port = terminal::open(path);
    let mut buffer = [0; 4096];
    let mut due = Instant::now();
    let mut scan = || {
        if let Some(period) = pattern.period() {
            due += period;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        port.write_all(b"G04472501\n").unwrap();
        let mut length = 0;
        while !buffer[..length].ends_with(b"\n\n") {
            length += port.read(&mut buffer[length..]).unwrap();
        }
        age_of(&buffer[..length])
    };
    for _ in 0..FIRST_SCANS {
        scan();
    }
    let (cpu, woken) = (cpu_time(), wake_ups());
    let latencies = (0..scans).map(|_| scan()).collect();
    Cost { wake_ups: wake_ups() - woken, cpu: cpu_time() - cpu, latencies }
}

/// Returns the time since the stamp in a whole reply.
fn age_of(reply: &[u8]) -> Duration {
    assert_eq!(reply.len(), 1399);
    let [.., a, b, c, d, b'\n', b'\n'] = reply[..] else { panic!("no scan") };
    since(Stamp([a, b, c, d].map(|byte| u32::from(byte - b'0'))))
}

/// Does the same as the floor on tokio: a port of tokio-serial, a deadline, no decoding,
/// one task.
fn bare_tokio(path: &Path, pattern: &Pattern, scans: usize) -> Cost {
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let path = path.to_str().unwrap().to_owned();
    let period = pattern.period();
    let polling = runtime.spawn(async move {
        let mut port = SerialStream::open(&tokio_serial::new(path, 19_200)).unwrap();
        let mut buffer = [0; 4096];
        let mut due = tokio::time::Instant::now();
        let mut scan = async || {
            if let Some(period) = period {
                due += period;
                sleep_until(due).await;
            }
            AsyncWriteExt::write_all(&mut port, b"G04472501\n").await.unwrap();
            let reply = async {
                let mut length = 0;
                while !buffer[..length].ends_with(b"\n\n") {
                    let read = AsyncReadExt::read(&mut port, &mut buffer[length..]);
                    length += read.await.unwrap();
                }
                age_of(&buffer[..length])
            };
            timeout(Duration::from_secs(1), reply).await.unwrap()
        };
        for _ in 0..FIRST_SCANS {
            scan().await;
        }
        let (cpu, woken) = (cpu_time(), wake_ups());
        let mut latencies = Vec::with_capacity(scans);
        for _ in 0..scans {
            latencies.push(scan().await);
        }
        Cost { wake_ups: wake_ups() - woken, cpu: cpu_time() - cpu, latencies }
    });
    runtime.block_on(polling).unwrap()
}

/// Polls through the driver, with the consumer in a task of its own.
fn driver(unpaused: bool, path: &Path, pattern: &Pattern, scans: usize) -> Cost {
    let path = path.to_str().unwrap().to_owned();
    let rate = pattern.rate.map_or(Rate::UNLIMITED, |rate| Rate::hz(f64::from(rate)));
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let polling = runtime.spawn(async move {
        let sensor = match unpaused {
            true => Sensor::builder().connect(Unpaused::At(path)).await.unwrap(),
            false => Sensor::open(path).await.unwrap(),
        };
        let mut stream = sensor.scans(Window::DETECTION, rate).await.unwrap();
        let mut next = async || {
            let scan = stream.next().await.unwrap().unwrap();
            let values: Vec<u32> = scan.raw_values().collect();
            let [.., first, second] = *values else { panic!("no scan") };
            let sextets = [first >> 6, first & 63, second >> 6, second & 63];
            since(Stamp(sextets))
        };
        for _ in 0..FIRST_SCANS {
            next().await;
        }
        let (cpu, woken) = (cpu_time(), wake_ups());
        let mut latencies = Vec::with_capacity(scans);
        for _ in 0..scans {
            latencies.push(next().await);
        }
        let cost = Cost { wake_ups: wake_ups() - woken, cpu: cpu_time() - cpu, latencies };
        sensor.close().await;
        cost
    });
    runtime.block_on(polling).unwrap()
}

/// A time of day in microseconds, 24 bits of it, in the last two points of a scan.
struct Stamp([u32; 4]);

impl Stamp {
    fn now() -> Self {
        let micros = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as u32;
        Self([18, 12, 6, 0].map(|shift| micros >> shift & 63))
    }

    fn micros(&self) -> u32 {
        self.0.iter().fold(0, |sum, sextet| sum << 6 | sextet)
    }
}

/// Returns the time that has gone by since `stamp`, 16 s at most.
fn since(stamp: Stamp) -> Duration {
    let micros = Stamp::now().micros().wrapping_sub(stamp.micros()) & 0xff_ffff;
    Duration::from_micros(micros.into())
}

/// A serial port that does not pass on its ability to suspend wake-ups.
enum Unpaused {
    At(String),
    Open(Box<dyn Port>),
}

impl Connect for Unpaused {
    type Port = Self;

    async fn connect(&mut self) -> Result<Self, Error> {
        let Self::At(path) = self else { panic!("connected once") };
        Ok(Self::Open(Endpoint::Serial(path.clone()).into_connector().connect().await?))
    }
}

impl Unpaused {
    fn port(&mut self) -> &mut Box<dyn Port> {
        let Self::Open(port) = self else { panic!("not open") };
        port
    }
}

impl Port for Unpaused {
    fn baud_rate(&self) -> Option<BaudRate> {
        let Self::Open(port) = self else { panic!("not open") };
        port.baud_rate()
    }

    fn poll_set_baud_rate(
        &mut self,
        cx: &mut Context<'_>,
        baud_rate: BaudRate,
    ) -> Poll<io::Result<()>> {
        self.port().poll_set_baud_rate(cx, baud_rate)
    }

    fn hints(&mut self) -> Option<&mut dyn PortHints> {
        Some(self)
    }
}

impl PortHints for Unpaused {
    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        self.port().hints()?.try_read(buffer)
    }
}

impl AsyncRead for Unpaused {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(self.port()).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Unpaused {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(self.port()).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.port()).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(self.port()).poll_shutdown(cx)
    }
}

/// Plays the sensor, and prints the path of its pseudo-terminal. Each piece is written at
/// the time when its last byte has come.
fn serve(pattern: &Pattern) {
    let mut terminal = terminal::Terminal::open();
    println!("{}", terminal.path.display());
    let (mut command, mut reply) = (Vec::new(), Vec::new());
    let mut revolution = Instant::now();
    while terminal::read_command(&mut terminal.master, &mut command).is_some() {
        reply.clear();
        instant_sensor::reply(&command, &mut reply);
        let is_scan = reply.len() > 1000;
        let now = Instant::now();
        while revolution < now {
            revolution += REVOLUTION;
        }
        let begins = match pattern.begins {
            Begins::AtOnce => now,
            Begins::Later => now + Duration::from_millis(90),
            Begins::WithTheMotor => revolution,
        };
        let (mut due, mut rest) = (begins, &mut reply[..]);
        while !rest.is_empty() {
            // The last piece has room for the stamp.
            let is_last = rest.len() < pattern.piece + END_BYTES;
            let length = if is_last { rest.len() } else { pattern.piece };
            let (piece, after) = rest.split_at_mut(length);
            rest = after;
            due += pattern.interval.mul_f64(length as f64 / pattern.piece as f64);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            if is_scan && is_last {
                let stamp = Stamp::now().0.map(|sextet| sextet as u8 + b'0');
                piece[length - END_BYTES..][..4].copy_from_slice(&stamp);
            }
            if terminal.master.write_all(piece).is_err() {
                return;
            }
        }
    }
}
