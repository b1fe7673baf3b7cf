//! The cost of dropping pending input before each command: one read of the port, counted on
//! the paused clock with a sensor in memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use tokio_scip::port::StreamPort;
use tokio_scip::{Rate, Window};

use crate::common::hooked::{Hooked, Hooks};
use crate::common::instant_sensor::InstantSensor;
use crate::common::{ConnectFn, builder};

/// Counts reads, those that find nothing among them.
struct CountReads(Arc<AtomicU64>);

impl Hooks for CountReads {
    fn before_read(&mut self) {
        self.0.fetch_add(1, Relaxed);
    }
}

#[tokio::test(start_paused = true)]
async fn pending_bytes_are_read_once_a_poll() {
    const SCANS: u64 = 20;
    let reads = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&reads);
    let connect = ConnectFn(move || {
        let port = StreamPort::new(InstantSensor::new());
        Ok(Hooked { port, hooks: CountReads(Arc::clone(&count)) })
    });
    let sensor = builder().connect(connect).await.unwrap();
    let mut stream = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    stream.next().await.unwrap().unwrap();
    let before = reads.load(Relaxed);
    for _ in 0..SCANS {
        stream.next().await.unwrap().unwrap();
    }
    // The wait for the next poll ends if bytes come, so it reads whenever it is polled, here
    // three times. Then come the read for pending bytes and the read of the reply.
    assert_eq!(reads.load(Relaxed) - before, 5 * SCANS);
}
