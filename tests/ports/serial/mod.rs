//! Serial ports on pseudo-terminals, and on files that are not serial ports. In real time,
//! without sleeping: each wait is for bytes. `wakeups` counts what a read costs, and `usb`
//! lists pseudo-terminals as sensors on USB.

#[cfg(target_os = "linux")]
mod usb;
mod wakeups;

#[cfg(target_os = "linux")]
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::Duration;

use crate::common::limit::limit;
use crate::common::{open_serial, set_baud_rate};
use futures::FutureExt;
#[cfg(target_os = "linux")]
use rustix::{
    fs::{Mode, OFlags},
    termios::{ioctl_tiocexcl, ioctl_tiocnxcl},
};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_scip::port::{Connect, Port};
use tokio_scip::{BaudRate, Endpoint, ErrorChain, ErrorKind};
use tokio_serial::SerialPort as _;
use tokio_serial::SerialStream;

/// A serial line with two ends, and the path of one of them.
struct SerialLine {
    far: SerialStream,
    /// Held open, so that the line does not hang up between two openings, and to read the
    /// line's settings.
    near: SerialStream,
    path: String,
}

fn line() -> SerialLine {
    limit();
    // Copies, which the programs that other tests start do not inherit.
    let (far, near) = serialport::TTYPort::pair().unwrap();
    let [far, near] = [far, near].map(|end| {
        let copy = end.try_clone_native().unwrap();
        SerialStream::try_from(copy).unwrap()
    });
    let path = near.name().unwrap();
    SerialLine { far, near, path }
}

/// A directory that is removed with its content.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("tokio-scip-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[tokio::test]
async fn all_six_baud_rates_are_set_and_in_force() {
    let line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    assert_eq!(port.baud_rate(), Some(BaudRate::B19200), "as a sensor after power-up");
    assert_eq!(line.near.baud_rate().unwrap(), 19_200);
    assert!(port.hints().unwrap().can_die_silently(), "it counts as a sensor's own USB port");
    for baud_rate in BaudRate::ALL.into_iter().rev() {
        set_baud_rate(&mut port, baud_rate).await.unwrap();
        assert_eq!(port.baud_rate(), Some(baud_rate));
        assert_eq!(line.near.baud_rate().unwrap(), u32::from(baud_rate));
    }
}

#[tokio::test]
async fn the_line_is_8n1_without_flow_control() {
    let mut line = line();
    line.near.set_parity(tokio_serial::Parity::Even).unwrap();
    line.near.set_stop_bits(tokio_serial::StopBits::Two).unwrap();
    line.near.set_flow_control(tokio_serial::FlowControl::Software).unwrap();
    let _port = open_serial(&line.path).await.unwrap();
    assert_eq!(line.near.data_bits().unwrap(), tokio_serial::DataBits::Eight);
    assert_eq!(line.near.parity().unwrap(), tokio_serial::Parity::None);
    assert_eq!(line.near.stop_bits().unwrap(), tokio_serial::StopBits::One);
    assert_eq!(line.near.flow_control().unwrap(), tokio_serial::FlowControl::None);
}

#[tokio::test]
async fn every_byte_passes_unchanged_both_ways() {
    let mut line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let every_byte: Vec<u8> = (0..=255).collect();
    let mut there = [0; 256];
    port.write_all(&every_byte).await.unwrap();
    line.far.read_exact(&mut there).await.unwrap();
    assert_eq!(there.as_slice(), every_byte);
    let mut back = [0; 256];
    line.far.write_all(&every_byte).await.unwrap();
    port.read_exact(&mut back).await.unwrap();
    assert_eq!(back.as_slice(), every_byte);
}

#[tokio::test]
async fn a_long_stream_is_read_in_any_pieces() {
    let mut line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let bytes: Vec<u8> =
        (0..500_000_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let write = async {
        let mut rest = bytes.as_slice();
        for size in (1..6000).step_by(7).cycle() {
            let Some((piece, after)) = rest.split_at_checked(size) else { break };
            line.far.write_all(piece).await.unwrap();
            rest = after;
        }
        line.far.write_all(rest).await.unwrap();
    };
    let mut came = vec![0; bytes.len()];
    let read = port.read_exact(&mut came);
    let both = tokio::time::timeout(Duration::from_secs(60), async { tokio::join!(write, read) });
    both.await.expect("the reader is not woken").1.unwrap();
    assert!(came == bytes);
}

/// Writes until the line accepts no more, as when a sensor does not read. Returns the
/// number of bytes accepted.
fn stall(port: &mut Box<dyn Port>) -> usize {
    let mut taken = 0;
    while let Some(written) = port.write(&[b'x'; 1024]).now_or_never() {
        taken += written.unwrap();
    }
    taken
}

#[tokio::test]
async fn o16_flush_and_shutdown_do_not_wait_for_a_stalled_line() {
    let line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    stall(&mut port);
    port.flush().now_or_never().unwrap().unwrap();
    port.shutdown().now_or_never().unwrap().unwrap();
}

#[tokio::test]
async fn a_stalled_write_goes_on_when_the_line_moves_again() {
    let mut line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let taken = stall(&mut port);
    let mut came = vec![0; taken + 1];
    let both = async { tokio::join!(port.write_all(b"V"), line.far.read_exact(&mut came)) };
    let both = tokio::time::timeout(Duration::from_secs(60), both);
    let (written, read) = both.await.expect("the writer waits on");
    written.unwrap();
    read.unwrap();
    assert_eq!(came.pop(), Some(b'V'));
}

/// Opens a port that was open before, until it is no longer busy: a program that another test
/// starts has this one's open ports, too, for a moment, from its fork until its exec.
async fn reopened(path: &str) -> Box<dyn Port> {
    let open = async {
        loop {
            match open_serial(path).await {
                Err(error) if matches!(error.kind(), ErrorKind::Busy { .. }) => {}
                outcome => return outcome.unwrap(),
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(10), open).await.expect("the port stays open")
}

#[tokio::test]
async fn o17_dropping_a_port_discards_its_unsent_output() {
    let mut line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let taken = stall(&mut port);
    drop(port);
    let mut port = reopened(&line.path).await;
    let write = tokio::time::timeout(Duration::from_secs(5), port.write_all(b"V"));
    write.await.expect("the line still does not move").unwrap();
    // A pseudo-terminal passes on a few KiB at once: those were sent.
    let mut came = 0;
    while line.far.read_u8().await.unwrap() != b'V' {
        came += 1;
    }
    assert!(came <= 4096 && came < taken, "{came} of {taken} bytes came");
}

#[tokio::test]
async fn o04_an_open_port_is_busy_until_it_is_dropped() {
    let line = line();
    let scratch = Scratch::new("busy");
    let link = scratch.path("sensor");
    std::os::unix::fs::symlink(&line.path, &link).unwrap();

    let port = open_serial(&link).await.unwrap();
    for path in [&line.path, &link] {
        let error = open_serial(path).await.err().unwrap();
        let ErrorKind::Busy { port } = error.kind() else { panic!("{error:?}") };
        assert_eq!(port, path);
    }
    drop(port);
    reopened(&line.path).await;
}

/// Opens a terminal as a program does that does not lock it.
#[cfg(target_os = "linux")]
fn open_beside(path: &str) -> OwnedFd {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    rustix::fs::open(path, flags, Mode::empty()).unwrap()
}

/// Also for root, whom the system would let in.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn o04_a_port_locked_by_tiocexcl_alone_stays_locked() {
    let line = line();
    let other = open_beside(&line.path);
    ioctl_tiocexcl(&other).unwrap();
    for _ in 0..2 {
        let error = open_serial(&line.path).await.err().unwrap();
        assert!(matches!(error.kind(), ErrorKind::Busy { .. }), "{error:?}");
    }
    ioctl_tiocnxcl(&other).unwrap();
    reopened(&line.path).await;
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn o04_the_lock_of_a_killed_program_is_named() {
    let SerialLine { far: _far, near, path } = line();
    drop(near);
    let killed = open_beside(&path);
    ioctl_tiocexcl(&killed).unwrap();
    drop(killed);
    let open = async {
        loop {
            let error = open_serial(&path).await.err().unwrap();
            // A program that another test starts has the terminal for a moment.
            if !matches!(error.kind(), ErrorKind::Busy { .. }) {
                break ErrorChain(&error).to_string();
            }
        }
    };
    let text =
        tokio::time::timeout(Duration::from_secs(10), open).await.expect("it counts as busy");
    assert!(text.contains("no program has it open"), "{text}");
}

#[tokio::test]
async fn a_given_up_change_of_baud_rate_disturbs_nothing() {
    let mut line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let mut given_up = 0;
    for baud_rate in BaudRate::ALL.into_iter().cycle().take(60) {
        given_up += usize::from(set_baud_rate(&mut port, baud_rate).now_or_never().is_none());
        line.far.write_all(b"V").await.unwrap();
        assert_eq!(port.read_u8().await.unwrap(), b'V');
        assert_eq!(port.baud_rate(), Some(baud_rate));
        assert_eq!(line.near.baud_rate().unwrap(), u32::from(baud_rate));
        drop(set_baud_rate(&mut port, BaudRate::B19200).now_or_never());
        set_baud_rate(&mut port, BaudRate::B750000).await.unwrap();
        assert_eq!(line.near.baud_rate().unwrap(), 750_000);
    }
    assert!(given_up > 0, "a change takes a thread, which is seldom done at the first poll");
}

#[tokio::test]
async fn a_dropped_opening_leaves_no_port_open() {
    let line = line();
    let mut connector = Endpoint::Serial(line.path.clone()).into_connector();
    let mut given_up = 0;
    // A program that another test starts has this one's open ports, too, for a moment:
    // from its fork until its exec. A port that stays open is busy for ever.
    for _ in 0..100 {
        given_up += usize::from(connector.connect().now_or_never().is_none());
        let open = async {
            loop {
                match connector.connect().await {
                    Err(error) if matches!(error.kind(), ErrorKind::Busy { .. }) => {}
                    outcome => return outcome.unwrap(),
                }
            }
        };
        drop(tokio::time::timeout(Duration::from_secs(10), open).await.unwrap());
    }
    assert!(given_up > 0, "opening takes a thread, which is seldom done at the first poll");
}

#[tokio::test]
async fn o07_bytes_received_before_the_port_was_opened_are_read() {
    let mut line = line();
    line.far.write_all(b"left").await.unwrap();
    let mut port = open_serial(&line.path).await.unwrap();
    let mut bytes = [0; 4];
    port.read_exact(&mut bytes).await.unwrap();
    assert_eq!(&bytes, b"left");
}

#[tokio::test]
async fn o01_a_hung_up_line_ends_reads_and_fails_writes() {
    let line = line();
    let mut port = open_serial(&line.path).await.unwrap();
    let SerialLine { far, near, .. } = line;
    drop((far, near));
    for _ in 0..3 {
        match port.read(&mut [0; 16]).await {
            Ok(read) => assert_eq!(read, 0),
            Err(error) => assert!(error.raw_os_error().is_some(), "{error:?}"),
        }
    }
    assert!(port.write(b"V\n").await.unwrap_err().raw_os_error().is_some());
    assert!(set_baud_rate(&mut port, BaudRate::B57600).await.is_err());
    assert_eq!(port.baud_rate(), Some(BaudRate::B19200));
    port.hints().unwrap().discard_output();
}

#[tokio::test]
async fn o06_wrong_paths_have_different_errors() {
    let scratch = Scratch::new("files");
    let file = scratch.path("file");
    std::fs::write(&file, "no port").unwrap();
    let dangling = scratch.path("dangling");
    std::os::unix::fs::symlink(scratch.path("gone"), &dangling).unwrap();

    for path in [&scratch.path("missing"), &dangling, &format!("{file}/below")] {
        let error = open_serial(path).await.err().unwrap();
        let ErrorKind::NoSuchPort { port } = error.kind() else { panic!("{path}: {error:?}") };
        assert_eq!(port, path);
    }
    for path in [&file, &scratch.path(""), "/dev/null"] {
        let error = open_serial(path).await.err().unwrap();
        let ErrorKind::NotASerialPort { port } = error.kind() else { panic!("{path}: {error:?}") };
        assert_eq!(port, path);
    }
    assert_eq!(std::fs::read(&file).unwrap(), b"no port");
}

#[tokio::test]
async fn a_serial_number_that_no_port_has_is_an_error() {
    let mut connector = Endpoint::SerialNumber("H0000000".to_owned()).into_connector();
    assert_eq!(connector.hints().unwrap().expected_serial_number(), Some("H0000000"));
    loop {
        match connector.connect().await {
            // A machine with sensors: this one is not theirs.
            Ok(port) => drop(port),
            Err(error) => {
                assert!(matches!(error.kind(), ErrorKind::NoSuchSensor { .. }), "{error}");
                break;
            }
        }
    }
    assert!(!connector.hints().unwrap().has_more());
}
