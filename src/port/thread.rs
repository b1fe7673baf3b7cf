//! Calls of the system that may wait, each on a thread of its own.
//!
//! tokio's blocking threads do not serve: a dropped runtime waits for their calls, and starts none.

use std::io;
#[cfg(feature = "serial")]
use std::sync::mpsc;
use std::thread::Builder;
#[cfg(feature = "serial")]
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::oneshot;

/// Time that [`drop_on`] waits. A port closes in less than a millisecond, unless its device hangs.
/// Linux keeps a program that exits before its thread closes such a port for half a minute;
/// afterwards the exit interrupts the thread.
#[cfg(feature = "serial")]
const GRACE: Duration = Duration::from_millis(20);

/// Runs `call` in the context of this runtime. The receiver gets its result, or the thread drops it.
///
/// # Errors
///
/// Fails if the system has no more threads.
///
/// # Panics
///
/// Panics outside of a tokio runtime.
pub(super) fn run_on<T: Send + 'static>(
    call: impl FnOnce() -> T + Send + 'static,
) -> io::Result<oneshot::Receiver<T>> {
    let (sender, receiver) = oneshot::channel();
    let runtime = Handle::current();
    thread().spawn(move || {
        let _context = runtime.enter();
        drop(sender.send(call()));
    })?;
    Ok(receiver)
}

/// Drops `value`, and returns when it is dropped or after [`GRACE`].
#[cfg(feature = "serial")]
pub(super) fn drop_on<T: Send + 'static>(value: T) {
    let (sender, dropped) = mpsc::channel::<()>();
    // In this order. Without a thread they are dropped here, with the closure.
    let _ = thread().spawn(move || drop((value, sender)));
    // Ends when the sender is dropped.
    let _ = dropped.recv_timeout(GRACE);
}

fn thread() -> Builder {
    Builder::new().name("tokio-scip".to_owned())
}

#[cfg(all(test, feature = "serial"))]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Hangs when it is dropped, as the port of a stuck device does, until the sender is dropped.
    struct Hanging(mpsc::Receiver<()>);

    impl Drop for Hanging {
        fn drop(&mut self) {
            let _ = self.0.recv();
        }
    }

    #[test]
    fn a_hanging_call_delays_neither_runtime_nor_program() {
        let [(end_call, call), (end_port, port)] = [mpsc::channel(), mpsc::channel()];
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let mut ended = runtime.block_on(async { run_on(move || drop(Hanging(call))) }).unwrap();
        drop(runtime);
        drop_on(Hanging(port));
        assert_eq!(ended.try_recv(), Err(oneshot::error::TryRecvError::Empty));
        drop((end_call, end_port));
        ended.blocking_recv().unwrap();
    }
}
