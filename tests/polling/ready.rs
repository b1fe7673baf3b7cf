//! A port whose replies are ready: other tasks of the runtime still have their turn.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use tokio::task::{spawn, yield_now};
use tokio_scip::port::StreamPort;
use tokio_scip::{Rate, Window};

use crate::common::hooked::{Hooked, Hooks};
use crate::common::instant_sensor::InstantSensor;
use crate::common::ready_port::ReadyPort;
use crate::common::{ConnectFn, builder};

/// tokio looks at what else is ready after 61 polls of tasks, in each of which a task has a
/// budget of 128.
const MOST_IN_A_ROW: u64 = 61 * 128;

/// Counts the commands since another task ran, and panics after too many: a driver that
/// never yields would block the test for ever.
struct CountCommands(Arc<AtomicU64>);

impl Hooks for CountCommands {
    fn before_write(&mut self, _bytes: &[u8]) {
        assert!(self.0.fetch_add(1, Relaxed) < MOST_IN_A_ROW, "no other task has its turn");
    }
}

#[tokio::test]
async fn ready_replies_leave_other_tasks_their_turn() {
    let commands = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&commands);
    let connect = move || {
        let port = StreamPort::new(InstantSensor::new());
        Ok(ReadyPort::new(Hooked { port, hooks: CountCommands(Arc::clone(&counted)) }))
    };
    let sensor = builder().reconnect(false).connect(ConnectFn(connect)).await.unwrap();
    let other = spawn(async move {
        loop {
            commands.store(0, Relaxed);
            yield_now().await;
        }
    });
    let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
    for _ in 0..5 {
        stream.next().await.unwrap().unwrap();
    }
    other.abort();
}
