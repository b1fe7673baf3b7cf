//! The driver on a pseudo-terminal, in real time: behaviour that only a real terminal has.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use crate::common::hooked::{Hooked, Hooks};
use crate::common::{Truth, builder, open_serial, truthful};
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;
use tokio_scip::port::{Connect, Port};
use tokio_scip::{BaudRate, Error, ErrorKind, Rate, State, Window};
use urg_emulator::{Emulator, Pty};

/// Serves the emulated sensor on a terminal with a stable name.
fn serve(emulator: &Emulator, name: &str) -> (PathBuf, JoinHandle<std::io::Result<()>>) {
    let path = std::env::temp_dir().join(format!("tokio-scip-{name}-{}", std::process::id()));
    let terminal = Pty::open(emulator, Some(&path)).unwrap();
    (path, tokio::spawn(terminal.serve()))
}

/// Opens a serial port by its path, and counts the calls on it.
struct Counting {
    path: String,
    counts: Arc<Counts>,
}

struct Counts {
    opened: AtomicU64,
    /// A permit for each attempt to open the port that failed.
    refused: Semaphore,
    /// Number of reads that reported the end of the port.
    dead_reads: AtomicU64,
    flushes: AtomicU64,
}

impl Counts {
    fn new() -> Self {
        Self {
            opened: AtomicU64::new(0),
            refused: Semaphore::new(0),
            dead_reads: AtomicU64::new(0),
            flushes: AtomicU64::new(0),
        }
    }
}

struct CountedCalls(Arc<Counts>);

impl Connect for Counting {
    type Port = Hooked<Box<dyn Port>, CountedCalls>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let port = open_serial(&self.path).await;
        match port {
            Ok(_) => drop(self.counts.opened.fetch_add(1, Relaxed)),
            Err(_) => self.counts.refused.add_permits(1),
        }
        Ok(Hooked { port: port?, hooks: CountedCalls(Arc::clone(&self.counts)) })
    }
}

impl Hooks for CountedCalls {
    fn after_read(&mut self, count: usize) {
        self.0.dead_reads.fetch_add(u64::from(count == 0), Relaxed);
    }

    fn on_flush(&mut self) {
        self.0.flushes.fetch_add(1, Relaxed);
    }
}

#[tokio::test]
async fn o01_o16_a_stream_survives_a_replug() {
    let emulator = truthful().build();
    let (path, _serving) = serve(&emulator, "replug");
    let counts = Arc::new(Counts::new());
    let connect = Counting { path: path.to_str().unwrap().into(), counts: Arc::clone(&counts) };
    let sensor = builder().connect(connect).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let state = sensor.watch_state();
    for round in 1..=2 {
        stream.next().await.unwrap().unwrap();
        counts.refused.forget_permits(Semaphore::MAX_PERMITS);
        emulator.unplug();
        let start = Instant::now();
        let error = loop {
            if let Err(error) = stream.next().await.unwrap() {
                break error;
            }
        };
        assert!(matches!(error.kind(), ErrorKind::Disconnected { .. }), "{error:?}");
        // The driver has failed to open the port a few times.
        counts.refused.acquire_many(3).await.unwrap().forget();
        // The pauses between attempts are at least 100 ms and 200 ms.
        assert!(start.elapsed() >= Duration::from_millis(100 + 200));
        // The port was dropped at the first read that reported its end.
        assert_eq!(counts.dead_reads.load(Relaxed), round);
        emulator.plug_in();
        let scan = stream.next().await.unwrap().unwrap();
        Truth::from_log(&emulator.log()).check(&scan).unwrap();
        assert!(matches!(state.get(), State::Connected { .. }));
        assert_eq!(counts.opened.load(Relaxed), round + 1);
    }
    assert_eq!(
        counts.flushes.load(Relaxed),
        0,
        "flush was called: it blocks the runtime until the port has drained"
    );
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn o04_a_killed_client_leaves_no_lock() {
    use rustix::fs::{Mode, OFlags};

    let (path, _serving) = serve(&truthful().build(), "killed");
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let client = rustix::fs::open(&path, flags, Mode::empty()).unwrap();
    rustix::termios::ioctl_tiocexcl(&client).unwrap();
    drop(client);
    let open = async {
        loop {
            match open_serial(path.to_str().unwrap()).await {
                Err(error) if matches!(error.kind(), ErrorKind::Busy { .. }) => {}
                outcome => break outcome.unwrap(),
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(10), open).await.expect("it stays locked");
}

#[tokio::test]
async fn a_terminal_changes_its_baud_rate() {
    let emulator = truthful().baud_rate(BaudRate::B57600).build();
    let (path, _serving) = serve(&emulator, "baud_rate");
    let sensor = builder().baud_rate(BaudRate::B250000).open(path.to_str().unwrap()).await.unwrap();
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B250000));
    assert!(emulator.counts().garbled > 0, "bytes at the wrong baud rate were not garbled");
    let scan = sensor.scan(Window::DETECTION).await.unwrap();
    Truth::from_log(&emulator.log()).check(&scan).unwrap();
    // Another program opens the port, at its old baud rate, when the driver is gone.
    sensor.close().await;
    let sensor = builder().open(path.to_str().unwrap()).await.unwrap();
    sensor.scan(Window::FULL).await.unwrap();
    let busy = builder().open(path.to_str().unwrap()).await.unwrap_err();
    assert!(matches!(busy.kind(), ErrorKind::Busy { .. }), "{busy:?}");
}

#[tokio::test]
async fn scans_through_a_tcp_bridge_are_right() {
    let emulator = truthful().build();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let server = emulator.clone();
    let _serving = tokio::spawn(async move { server.serve_tcp(listener).await });
    let sensor = builder().open(format!("tcp://{address}")).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut scans = Vec::new();
    while scans.len() < 5 {
        scans.push(stream.next().await.unwrap().unwrap());
    }
    let mut truth = Truth::from_log(&emulator.log());
    assert!(scans.iter().all(|scan| truth.check(scan).is_ok()));
    let error = sensor.set_baud_rate(BaudRate::B115200).await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::UnsupportedBaudRate { .. }), "{error:?}");
}
