//! The cause that calls and streams get when something panics.

use std::sync::mpsc;
use std::thread;

use crate::common::hooked::{Hooked, Hooks};
use crate::common::limit::limit;
use crate::common::{ConnectFn, builder};
use crate::link::reconnect::open;
use tokio::runtime;
use tokio_scip::{ErrorKind, State, Window};
use urg_emulator::{Emulator, Pace};

/// Panics when a scan is asked for.
struct PanicAtScan;

impl Hooks for PanicAtScan {
    fn before_write(&mut self, bytes: &[u8]) {
        assert!(!bytes.starts_with(b"G100200"), "injected");
    }
}

#[test]
fn a06_a_request_gets_the_drivers_panic() {
    limit();
    std::panic::set_hook(Box::new(|_| {}));
    let runtime = runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let errors = runtime.unwrap().block_on(async {
        let mut errors = Vec::new();
        for _ in 0..300 {
            let emulator = Emulator::builder().pace(Pace::AtOnce).build();
            let connect = move || Ok(Hooked { port: emulator.link(), hooks: PanicAtScan });
            let sensor = builder().connect(ConnectFn(connect)).await.unwrap();
            errors.extend(sensor.scan(Window::new(100..=200).unwrap()).await.err());
        }
        errors
    });
    let _ = std::panic::take_hook();
    let others = errors.iter().filter(|error| !matches!(error.kind(), ErrorKind::Panicked { .. }));
    assert_eq!((errors.len(), others.count()), (300, 0));
}

#[test]
fn a06_a_panic_elsewhere_spares_the_driver() {
    limit();
    let (sender, receiver) = mpsc::channel();
    let thread = thread::spawn(move || {
        let runtime =
            runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
        let sensor = runtime.block_on(async { open(&Emulator::default()).await });
        sender.send(sensor).unwrap();
        // Drops the runtime, and so the driver.
        panic!("elsewhere");
    });
    let sensor = receiver.recv().unwrap();
    assert!(thread.join().is_err());
    let state = sensor.watch_state().get();
    assert!(matches!(state, State::Closed { error: None }), "{state:?}");
}
