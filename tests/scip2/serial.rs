//! A URG-04LX in SCIP 2 on RS-232, where a reply takes much longer than a command.

use std::io;
use std::task::{Context, Poll, Waker};

use tokio::io::ReadBuf;
use tokio::time::{Instant, sleep};
use tokio_scip::protocol::Protocol;
use tokio_scip::scan::StampQuality;
use tokio_scip::{BaudRate, Error, Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Fault, Faults, Firmware, Fixed, Model};

use super::refusals::{PARAMETERS, VERSION};
use super::times::lateness;
use super::{next, numbered};
use crate::common::limit::limit;
use crate::common::random::{Random, seeds};
use crate::common::test_port::{FarEnd, TestPort};
use crate::common::{ConnectFn, builder, ms, wire_time};

/// Opens a sensor in SCIP 2 at this baud rate.
async fn open(baud_rate: BaudRate) -> (Emulator, Sensor) {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).baud_rate(baud_rate).build();
    let asking = builder().depth(64).protocol(Protocol::Scip2);
    let sensor = asking.connect(emulator.clone()).await.unwrap();
    (emulator, sensor)
}

/// Makes a request that ends a stream, or starts it anew.
async fn disturb(sensor: Sensor, number: u64) -> Result<(), Error> {
    match number {
        0 => sensor.laser_on().await,
        1 => sensor.laser_off().await,
        2 => sensor.sensor_state().await.map(drop),
        3 => sensor.set_baud_rate(BaudRate::B57600).await,
        4 => sensor.scan(Window::DETECTION).await.map(drop),
        _ => {
            let mut other = sensor.scans(Window::new(100..=200).unwrap(), Rate::hz(5.0)).await?;
            other.next().await.map_or(Ok(()), |scan| scan.map(drop))
        }
    }
}

/// Of a scan that is on its way when a command is sent.
#[tokio::test(start_paused = true)]
async fn a_command_does_not_change_when_a_scan_began() {
    for seed in seeds("SCIP_SERIAL", 100) {
        let mut random = Random::new(seed);
        let baud_rate = *random.pick(&BaudRate::ALL[..4]);
        let (emulator, sensor) = open(baud_rate).await;
        let window = Window::new(300..=560).unwrap();
        let mut stream = sensor.scans(window, Rate::hz(1.0)).await.unwrap();
        let mut before: Scan = next(&mut stream).await;
        for _ in 0..3 {
            sleep(ms(800) + random.ms(600)).await;
            let _ = disturb(sensor.clone(), random.below(6)).await;
            sensor.laser_on().await.unwrap();
            let scan = next(&mut stream).await;
            let late = lateness(&emulator, &scan);
            // The first byte takes half a millisecond, and a timer one.
            assert!(late.abs() < 2.0, "seed {seed}, {baud_rate}: {late} ms");
            assert!(scan.times().requested_at >= before.received_at(), "seed {seed}: {scan:?}");
            before = scan;
        }
    }
}

/// A sensor that falls silent between two commands of a request.
#[tokio::test(start_paused = true)]
async fn a17_closing_within_a_request_takes_two_commands() {
    for seed in seeds("SCIP_SERIAL", 300) {
        let mut random = Random::new(seed);
        let baud_rate = BaudRate::B750000;
        let (emulator, sensor) = open(baud_rate).await;
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        let _stream = (!random.once_in(3)).then_some(stream);
        sleep(ms(200)).await;
        let number = random.below(6);
        tokio::spawn(disturb(sensor.clone(), number));
        sleep(random.ms(500)).await;
        emulator.set_faults(Faults::none().every(Fault::CommandLost));
        sleep(random.ms(1000)).await;
        let start = Instant::now();
        sensor.close().await;
        // A text, and two scans that may be on the way before.
        let wire = 2 * wire_time(baud_rate, 600 + 2 * 2200);
        // The scan of a stream is due after another revolution, or two at 5 Hz.
        let period = ms(if number < 4 { 0 } else { (number - 3) * 100 });
        let took = start.elapsed();
        assert!(took <= ms(1505) + period + wire, "seed {seed}, {number}: {took:?}");
    }
}

/// A scan that was on its way when the stream was widened lacks the window, and is none of its scans.
#[tokio::test(start_paused = true)]
async fn a_stream_that_widens_another_begins_at_once() {
    let cases =
        BaudRate::ALL[2..].iter().flat_map(|rate| (0..100).step_by(9).map(|ms| (*rate, ms)));
    for (baud_rate, pause) in cases {
        let (_emulator, sensor) = open(baud_rate).await;
        let narrow = Window::new(300..=450).unwrap();
        let mut front = sensor.scans(narrow, Rate::UNLIMITED).await.unwrap();
        next(&mut front).await;
        sleep(ms(2000 + pause)).await;
        let (start, before) = (Instant::now(), sensor.stats());
        let wide = Window::new(280..=450).unwrap();
        let mut all = sensor.scans(wide, Rate::hz(1.0)).await.unwrap();
        next(&mut all).await;
        // A second later is the next point of its grid.
        let took = start.elapsed();
        assert!(took < ms(600), "{baud_rate}, {pause} ms: {took:?}");
        let stats = sensor.stats();
        assert_eq!(
            stats.polls - before.polls,
            stats.scans - before.scans,
            "{baud_rate}, {pause} ms"
        );
    }
}

/// Sensor of SCIP 2 at 57,600 baud. The adapter has kept the scan of a stream, which the first reads
/// return, whatever its baud rate is.
#[derive(Debug)]
struct Kept {
    baud_rate: BaudRate,
    kept: usize,
    input: Vec<u8>,
    reader: Option<Waker>,
}

impl FarEnd for Kept {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.input.is_empty() {
            self.reader = Some(cx.waker().clone());
            return Poll::Pending;
        }
        let count = self.input.len().min(buffer.remaining());
        buffer.put_slice(&self.input.drain(..count).collect::<Vec<_>>());
        Poll::Ready(Ok(()))
    }

    fn write(&mut self, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let reply = match bytes {
            _ if self.baud_rate != BaudRate::B57600 && self.kept > 0 => {
                self.kept -= 1;
                "MD0044072501000\n99b\n\n".to_owned()
            }
            _ if self.baud_rate != BaudRate::B57600 => String::new(),
            command => {
                let command = str::from_utf8(command).unwrap().trim();
                let answer = match command.get(..2) {
                    Some("VV") => VERSION,
                    Some("PP") => PARAMETERS,
                    Some("QT") => "00P",
                    _ => "0Ee",
                };
                format!("{command}\n{answer}\n\n")
            }
        };
        self.input.extend(reply.into_bytes());
        if let Some(reader) = self.reader.take() {
            reader.wake();
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn baud_rate(&self) -> Option<BaudRate> {
        Some(self.baud_rate)
    }

    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.baud_rate = baud_rate;
        Ok(())
    }
}

#[tokio::test(start_paused = true)]
async fn the_rest_of_a_stream_does_not_end_a_search() {
    limit();
    for kept in 0..3 {
        let port = move || {
            let (baud_rate, input) = (BaudRate::B19200, Vec::new());
            Ok(TestPort(Kept { baud_rate, kept, input, reader: None }))
        };
        let sensor = builder().connect(ConnectFn(port)).await.unwrap();
        assert_eq!(sensor.watch_state().get().baud_rate(), Some(BaudRate::B57600), "{kept}");
    }
}

/// A covered sensor sends the same value for each step. Read at another baud rate, its scans are many
/// empty replies.
#[tokio::test(start_paused = true)]
async fn a_stream_at_another_baud_rate_does_not_end_a_search() {
    limit();
    for phase in 0..20 {
        let sensor = Emulator::builder().firmware(Firmware::V31).baud_rate(BaudRate::B750000);
        let emulator = sensor.world(Fixed::filled(17)).build();
        let asking = builder().protocol(Protocol::Scip2);
        let (sensor, driver) = asking.build(emulator.clone());
        let driver = tokio::spawn(driver);
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        driver.abort();
        sleep(ms(5 * phase)).await;
        let sensor = builder().connect(emulator).await.unwrap();
        assert_eq!(sensor.watch_state().get().baud_rate(), Some(BaudRate::B750000), "{phase}");
    }
}

/// The motor turns faster than the sensor tells, or the baud rate is unknown, and the first scan comes
/// late: so does each one of the backlog, at an even pace.
#[tokio::test(start_paused = true)]
async fn a_backlog_on_a_full_line_shows_no_clock() {
    for seed in seeds("SCIP_BACKLOG", 40) {
        let mut random = Random::new(seed);
        let revolution = ms(85) + random.ms(5);
        let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31).revolution(revolution);
        let emulator = emulator.baud_rate(BaudRate::B250000).build();
        let asking = builder().depth(64).protocol(Protocol::Scip2);
        let sensor = match random.below(2) {
            0 => asking.connect(emulator.clone()).await.unwrap(),
            _ => asking.attach(emulator.bridge(BaudRate::B250000)).await.unwrap(),
        };
        let last = 716 + random.below(10) as u16;
        let window = Window::new(44..=last).unwrap();
        let late = Fault::Late(ms(20) + random.ms(80));
        emulator.set_faults(Faults::none().at(1 + random.below(2), late));
        let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
        for _ in 0..60 {
            let scan = next(&mut stream).await;
            let late = lateness(&emulator, &scan);
            let is_by_clock = scan.times().quality == StampQuality::SensorClock;
            assert!(
                !is_by_clock || late.abs() < 4.0,
                "seed {seed}, {revolution:?}, {last}: {late} ms"
            );
        }
    }
}

/// How long a reply takes behind a bridge is learned from the ones before, in either protocol.
#[tokio::test(start_paused = true)]
async fn a_line_of_unknown_speed_delivers_every_reply() {
    for seed in seeds("SCIP_BRIDGES", 60) {
        let mut random = Random::new(seed);
        let baud_rate = *random.pick(&BaudRate::ALL);
        let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
        let emulator = emulator.baud_rate(baud_rate).build();
        let protocol = *random.pick(&[Protocol::Scip1, Protocol::Scip2]);
        let asking = builder().protocol(protocol);
        let sensor = asking.attach(emulator.bridge(baud_rate)).await.unwrap();
        let first = 44 + random.below(300) as u16;
        let window = Window::new(first..=first + random.below(382) as u16).unwrap();
        let rate = *random.pick(&[Rate::UNLIMITED, Rate::hz(3.0), Rate::hz(0.3)]);
        let mut stream = sensor.scans(window, rate).await.unwrap();
        for _ in 0..8 {
            let scan = next(&mut stream).await;
            assert_eq!(scan.window(), window, "seed {seed}");
            if random.below(4) == 0 {
                sensor.scan(Window::DETECTION).await.unwrap();
            }
        }
        assert_eq!(sensor.stats().timeouts, 0, "seed {seed}, {baud_rate}, {protocol:?}");
    }
}
