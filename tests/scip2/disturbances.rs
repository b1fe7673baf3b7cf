//! What disturbs a stream of scans: single scans on a slow line, and a sensor that sends no
//! scans.

use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, DuplexStream, duplex, split};
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, ErrorKind, Rate, Window};
use urg_emulator::{Emulator, Firmware, Model};

use super::refusals::{PARAMETERS, VERSION};
use super::{next, numbered};
use crate::common::builder;

fn commands(emulator: &Emulator, head: &[u8]) -> usize {
    emulator.log().iter().filter(|line| line.line.starts_with(head)).count()
}

#[tokio::test(start_paused = true)]
async fn a_single_scan_does_not_slow_a_stream_down() {
    let emulator = numbered(Model::Urg04lx).firmware(Firmware::V31);
    let emulator = emulator.baud_rate(BaudRate::B115200).build();
    let asking = builder().protocol(Protocol::Scip2).depth(512);
    let sensor = asking.connect(emulator.clone()).await.unwrap();
    let front = Window::degrees(-10.0..=10.0).unwrap();
    let mut stream = sensor.scans(front, Rate::UNLIMITED).await.unwrap();
    next(&mut stream).await;
    assert!(commands(&emulator, b"MD") > 0);
    // Takes the line twice as long as a revolution.
    assert_eq!(sensor.scan(Window::DETECTION).await.unwrap().len(), 682);
    let end = Instant::now() + Duration::from_secs(5);
    let mut count = 0;
    while next(&mut stream).await.received_at() < end {
        count += 1;
    }
    assert!(count >= 45, "{count}");
}

/// Returns a sensor that answers its stream's command with `replies`, each 10 ms after the one before
/// and without the echo, and what it is asked.
fn sensor_with_a_stream_of(
    replies: fn(usize) -> Option<&'static str>,
) -> (DuplexStream, mpsc::UnboundedReceiver<String>) {
    let (near, far) = duplex(4096);
    let (log, asked) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        let (read, mut write) = split(far);
        let mut lines = BufReader::new(read).lines();
        let (mut stream, mut sent) = (None::<String>, 0);
        loop {
            let line = match timeout(Duration::from_millis(10), lines.next_line()).await {
                Ok(Ok(Some(line))) => Some(line),
                Ok(_) => return,
                Err(_) => None,
            };
            let frame = match (&line, &stream) {
                (Some(command), _) => {
                    let _ = log.send(command.clone());
                    (stream, sent) = (command.starts_with("MD").then(|| command.clone()), 0);
                    let reply = match command.get(..2) {
                        Some("VV") => VERSION,
                        Some("PP") => PARAMETERS,
                        Some("BM" | "QT") => "00P",
                        Some("GD") => "10Q",
                        Some("MD") => continue,
                        Some(_) => "0Ee",
                        None => continue,
                    };
                    format!("{command}\n{reply}\n\n")
                }
                (None, Some(command)) => {
                    let Some(reply) = replies(sent) else { continue };
                    sent += 1;
                    format!("{command}\n{reply}\n\n")
                }
                (None, None) => continue,
            };
            if write.write_all(frame.as_bytes()).await.is_err() {
                return;
            }
        }
    });
    (near, asked)
}

#[tokio::test(start_paused = true)]
async fn answers_without_scans_end_a_stream() {
    crate::common::limit::limit();
    let (port, _asked) = sensor_with_a_stream_of(|_| Some("00P"));
    let sensor = builder().attach(port).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    let item = timeout(Duration::from_secs(5), stream.next()).await;
    let error = item.unwrap().unwrap().unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::Timeout { .. }), "{error}");
}

#[tokio::test(start_paused = true)]
async fn nothing_goes_beside_a_stream_whose_answer_was_damaged() {
    crate::common::limit::limit();
    let (port, mut asked) = sensor_with_a_stream_of(|sent| (sent == 0).then_some("00Q"));
    let sensor = builder().attach(port).await.unwrap();
    let _stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    while !asked.recv().await.unwrap().starts_with("MD") {}
    let next = asked.recv().await.unwrap();
    assert!(next.starts_with("QT"), "{next}");
}
