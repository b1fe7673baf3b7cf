//! Faults of replies and of scans in a stream, and what `II` does to a stream.

use std::time::Duration;

use tokio::io::AsyncReadExt;
use tokio::time::sleep;
use tokio_scip::Window;
use tokio_scip::protocol::scip2::{Command, Content, Data, Reply, Request, Stream};
use urg_emulator::{Emulator, EmulatorBuilder, Fault, Faults, Model};

use super::sensor;
use crate::{ask, listen, listen_bytes};

const STREAM: &str = "MD0044004401000";
/// Each scan of it, but for its time.
const SCAN: &str = "MD0044004401000\n99b\n0000Y\n0CBe\n\n";

fn ust() -> EmulatorBuilder {
    sensor(Model::Ust10lx)
}

/// Replaces the time, so that scans can be compared.
fn timeless(scan: &[u8]) -> String {
    let mut text = String::from_utf8_lossy(scan).into_owned();
    if text.starts_with("MD0044004401000\n99b\n") && text.len() >= 26 {
        text.replace_range(20..25, "0000Y");
    }
    text
}

/// Returns what arrives in place of the third scan of a stream if it has the fault, and the scan
/// after it.
async fn third_scan(fault: Fault) -> (String, String) {
    let emulator = ust().faults(Faults::none().at(3, fault)).build();
    let mut link = emulator.link();
    ask(&mut link, STREAM).await;
    for _ in 0..2 {
        assert_eq!(timeless(&listen_bytes(&mut link).await), SCAN);
    }
    let third = listen_bytes(&mut link).await;
    (timeless(&third), timeless(&listen_bytes(&mut link).await))
}

#[tokio::test(start_paused = true)]
async fn a_scan_of_a_stream_meets_every_fault() {
    let scan = || SCAN.to_owned();
    for (fault, expected) in [
        (Fault::Lost, scan()),
        (Fault::CommandLost, scan()),
        (Fault::Late(Duration::from_millis(900)), scan()),
        (Fault::Doubled, scan()),
        (Fault::Flip(27, 1), SCAN.replace("0CBe", "0BBe")),
        (Fault::Drop(27..28), SCAN.replace("0CBe", "0Be")),
        (Fault::Repeat(26..29), SCAN.replace("0CBe", "0CB0CBe")),
        (Fault::Insert(25, b"x".to_vec()), SCAN.replace("Y\n", "Yx\n")),
        (Fault::Status(b'M'), "MD0044004401000\n0Mm\n\n".to_owned()),
        (Fault::Ignored, scan()),
        (Fault::Pause(20, Duration::from_millis(5)), scan()),
        (Fault::Trickle(Duration::from_micros(100)), scan()),
        (Fault::ClockJump(70), scan()),
    ] {
        let (third, fourth) = third_scan(fault.clone()).await;
        assert_eq!((third, fourth), (expected, scan()), "{fault:?}");
    }
    let (third, fourth) = third_scan(Fault::Merged).await;
    assert_eq!(third.len(), 2 * SCAN.len() - 1);
    assert_eq!(fourth, SCAN);
    let (third, _) = third_scan(Fault::Garbage(b"hello".to_vec())).await;
    assert!(third.starts_with("helloMD0044004401000\n99b\n"));
    let (third, _) = third_scan(Fault::CrLf).await;
    assert!(third.starts_with("MD0044004401000\r\n99b\r\n"));
}

#[tokio::test(start_paused = true)]
async fn a_late_scan_delays_the_later_ones() {
    let late = Duration::from_millis(100);
    let emulator = ust().faults(Faults::none().at(3, Fault::Late(late))).build();
    let mut link = emulator.link();
    ask(&mut link, STREAM).await;
    let mut arrived = Vec::new();
    for _ in 0..10 {
        listen(&mut link).await;
        arrived.push(tokio::time::Instant::now());
    }
    let gaps: Vec<u128> = arrived.windows(2).map(|two| (two[1] - two[0]).as_millis()).collect();
    assert_eq!(gaps, [25, 125, 0, 0, 0, 0, 25, 25, 25]);
}

#[tokio::test(start_paused = true)]
async fn a_reset_and_a_hang_up_end_a_stream() {
    for model in [Model::Utm30lx, Model::Ust10lx] {
        for fault in [Fault::Reset(10), Fault::HangUp(10)] {
            let emulator = sensor(model).faults(Faults::none().at(1, fault.clone())).build();
            let mut link = emulator.link();
            ask(&mut link, STREAM).await;
            assert_eq!(listen_bytes(&mut link).await, b"MD00440044", "{model:?} {fault:?}");
            let ends = model == Model::Ust10lx || fault == Fault::HangUp(10);
            let read = tokio::time::timeout(Duration::from_secs(1), link.read_u8()).await;
            assert_eq!(read.is_ok(), ends, "{model:?} {fault:?}");
            let mut link = emulator.link();
            let is_sending = !listen(&mut link).await.is_empty();
            assert_eq!(is_sending, fault == Fault::HangUp(10), "{model:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_wrong_sum_is_found_by_the_driver() {
    let window = Window::new(0..=1080).unwrap();
    let stream = Command::Stream(Stream::new(Data::Intensities, window));
    for seed in 0..50 {
        let faults = Faults::none().every(Fault::WrongSum).seed(seed);
        let mut link = ust().faults(faults).build().link();
        for command in [Command::Version, Command::Parameters, Command::Clock, stream] {
            let request = Request::new(command, None);
            let text = String::from_utf8(request.bytes().to_vec()).unwrap();
            let reply = ask(&mut link, &text).await;
            let error = Reply::parse(&request, reply.trim_end().as_bytes()).unwrap_err();
            assert!(error.to_string().contains("sum"), "{error}");
        }
        let request = Request::new(stream, None);
        let frame = listen_bytes(&mut link).await;
        let error = Reply::parse(&request, &frame[..frame.len() - 2]).unwrap_err();
        assert!(error.to_string().contains("sum"), "{error}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_stop_may_be_ignored() {
    let emulator = ust().faults(Faults::none().once("QT", Fault::Ignored)).build();
    let mut link = emulator.link();
    ask(&mut link, STREAM).await;
    assert_eq!(ask(&mut link, "QT").await, "QT\n00P\n\n");
    for _ in 0..5 {
        assert_eq!(timeless(&listen_bytes(&mut link).await), SCAN);
    }
    assert!(emulator.is_laser_on());
    assert_eq!(ask(&mut link, "QT").await, "QT\n00P\n\n");
    assert_eq!(listen(&mut link).await, "");
    assert_eq!(emulator.fault_count(&Fault::Ignored), 1);
}

#[tokio::test(start_paused = true)]
async fn faults_can_be_those_of_one_command() {
    let faults = Faults::none().on("TM", Fault::CommandLost).once("TM0", Fault::Status(b'M'));
    let emulator: Emulator = ust().faults(faults).build();
    let mut link = emulator.link();
    for _ in 0..3 {
        assert_eq!(ask(&mut link, "TM1").await, "");
        assert_eq!(ask(&mut link, "BM;x").await.get(..5), Some("BM;x\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn jumps_of_the_clock_are_in_the_stamps() {
    let faults = Faults::none().at(3, Fault::ClockJump(72));
    let mut link = ust().faults(faults).build().link();
    ask(&mut link, STREAM).await;
    let mut stamps = Vec::new();
    for _ in 0..5 {
        let scan = listen_bytes(&mut link).await;
        let number = |n: i64, byte: &u8| n * 64 + i64::from(byte - b'0');
        stamps.push(scan[20..24].iter().fold(0, number));
    }
    let gaps: Vec<i64> = stamps.windows(2).map(|two| two[1] - two[0]).collect();
    assert_eq!(gaps, [25, 97, 25, 25]);
}

/// As reported of real sensors: a UTM sends halves until the stream is asked for anew, a UST puts
/// the answer into a scan.
#[tokio::test(start_paused = true)]
async fn a_state_during_a_stream_disturbs_it() {
    let window = Window::new(0..=1080).unwrap();
    let request = Request::new(Command::Stream(Stream::new(Data::Distances, window)), None);
    let points = |frame: &[u8]| match Reply::parse(&request, &frame[..frame.len() - 2]) {
        Ok(Reply { content: Content::Scan(scan), .. }) => Some(scan.distances().len()),
        _ => None,
    };

    let mut link = sensor(Model::Utm30lx).build().link();
    ask(&mut link, "MD0000108001000").await;
    assert_eq!(points(&listen_bytes(&mut link).await), Some(1081));
    assert!(ask(&mut link, "II").await.starts_with("II\n00P\n"));
    for _ in 0..3 {
        let frame = listen_bytes(&mut link).await;
        // 540 points and not 1,081, each line with its sum.
        assert_eq!((points(&frame), frame.len()), (None, 20 + 6 + 1620 + 2 * 26 + 1));
    }
    ask(&mut link, "MD0000108001000").await;
    assert_eq!(points(&listen_bytes(&mut link).await), Some(1081));

    let mut link = ust().build().link();
    ask(&mut link, "MD0000108001000").await;
    assert_eq!(points(&listen_bytes(&mut link).await), Some(1081));
    let first = ask(&mut link, "II;x").await;
    let (scan, state) = first.split_at(first.find("II;x").unwrap());
    assert!(scan.starts_with("MD0000108001000\n99b\n") && scan.ends_with('\n'), "{scan}");
    assert!(state.contains("\nLASR:ON;9\n"));
    let rest = listen(&mut link).await;
    assert_eq!(points(format!("{scan}{rest}").as_bytes()), Some(1081));
    assert_eq!(points(&listen_bytes(&mut link).await), Some(1081));
    // A stop before the next scan.
    sleep(Duration::from_millis(1)).await;
    tokio::io::AsyncWriteExt::write_all(&mut link, b"II\nQT\n").await.unwrap();
    assert!(listen(&mut link).await.starts_with("II\n00P\n"));
    assert_eq!(listen(&mut link).await, "QT\n00P\n\n");
}
