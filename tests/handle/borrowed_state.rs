//! A user who holds the state for long does not stop the driver: the driver writes the state only
//! when it changes.

use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use futures::FutureExt;

use crate::common::limit::limit;
use crate::link::reconnect::open;
use tokio::runtime;
use tokio_scip::{Rate, Window};
use urg_emulator::Emulator;

#[test]
fn scans_go_on_while_the_state_is_borrowed() {
    limit();
    let (sender, scans) = mpsc::channel();
    let (send_state, state) = mpsc::channel();
    let (borrow, is_borrowed) = mpsc::channel();
    thread::spawn(move || {
        let runtime =
            runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
        runtime.block_on(async {
            let sensor = open(&Emulator::default()).await;
            let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
            stream.next().await.unwrap().unwrap();
            send_state.send(sensor.watch_state()).unwrap();
            is_borrowed.recv().unwrap();
            while let Some(item) = stream.next().await {
                if sender.send(item).is_err() {
                    return;
                }
            }
        });
    });
    let mut state = state.recv().unwrap();
    // The state is borrowed while it is compared.
    let looked = state.wait_for(|_| {
        borrow.send(()).unwrap();
        (0..20).all(|_| scans.recv_timeout(Duration::from_secs(10)).is_ok_and(|item| item.is_ok()))
    });
    let outcome = looked.now_or_never();
    assert!(outcome.is_some_and(|outcome| outcome.is_ok()), "no scans meanwhile");
}
