//! Runs every order of the tasks around a driver: the driver, calls of handles, a
//! stream, and what ends them. Only the executor is a model; all else is the crate and
//! tokio's channels.
//!
//! A task is polled only after it was woken, so that a lost wake-up shows as a task that
//! waits for ever. Orders inside of one poll are the business of `src/ring/tests.rs`, and
//! of tokio's own tests.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::time::Duration;

use tokio::sync::{Notify, oneshot};
use tokio::task::yield_now;
use tokio::time::timeout;
use tokio_scip::{Error, ErrorKind, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, Pace};

use super::chooser::Chooser;
use super::setting;

/// Time limit of a run, far longer than it takes on the paused clock.
const LIMIT: Duration = Duration::from_secs(60);
/// From this choice on no order is enumerated: the tasks have settled.
const CHOICES: usize = 40;

/// End of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OrderEnd {
    /// A handle closes it.
    Close,
    /// Its task is aborted.
    Abort,
    /// The link is lost, and is not to be opened again.
    Unplug,
    /// Handles and streams are dropped.
    Drop,
}

impl OrderEnd {
    /// Fails unless a call may return this error after such an end.
    fn check(self, error: &Error) {
        let expected = match self {
            Self::Close | Self::Abort => matches!(error.kind(), ErrorKind::Closed),
            // Also before the driver has opened the port.
            Self::Unplug => matches!(
                error.kind(),
                ErrorKind::Disconnected { .. } | ErrorKind::NoSuchPort { .. }
            ),
            Self::Drop => false,
        };
        assert!(expected, "{self:?}: {error:?}");
    }
}

type Boxed<'a> = Pin<Box<dyn Future<Output = ()> + 'a>>;

/// A task of the model.
struct Task<'a> {
    name: &'static str,
    /// `None` once it has ended.
    future: Option<Boxed<'a>>,
    woken: Arc<OrderWaker>,
}

struct OrderWaker {
    is_set: AtomicBool,
    executor: Arc<Notify>,
}

impl Wake for OrderWaker {
    fn wake(self: Arc<Self>) {
        self.is_set.store(true, Ordering::Relaxed);
        self.executor.notify_one();
    }
}

impl Task<'_> {
    fn is_ready(&self) -> bool {
        self.future.is_some() && self.woken.is_set.load(Ordering::Relaxed)
    }

    fn poll(&mut self) {
        self.woken.is_set.store(false, Ordering::Relaxed);
        let waker = Waker::from(Arc::clone(&self.woken));
        let Some(future) = &mut self.future else { return };
        if let Poll::Ready(()) = future.as_mut().poll(&mut Context::from_waker(&waker)) {
            self.future = None;
        }
    }
}

/// Runs tasks to their end. The chooser decides, for the choices in `enumerated`, which of the
/// woken tasks continues; before and after them each has its turn.
async fn execute(
    chooser: &mut Chooser,
    enumerated: Range<usize>,
    futures: Vec<(&'static str, Boxed<'_>)>,
) {
    let executor = Arc::new(Notify::new());
    let task = |(name, future)| {
        let woken = OrderWaker { is_set: AtomicBool::new(true), executor: Arc::clone(&executor) };
        Task { name, future: Some(future), woken: Arc::new(woken) }
    };
    let mut tasks: Vec<Task<'_>> = futures.into_iter().map(task).collect();
    let mut choices = 0;
    while tasks.iter().any(|task| task.future.is_some()) {
        let mut ready: Vec<&mut Task<'_>> =
            tasks.iter_mut().filter(|task| task.is_ready()).collect();
        if ready.is_empty() {
            // Nobody can go on until the clock has.
            let woken = timeout(LIMIT, executor.notified()).await;
            let waiting = tasks.iter().filter(|task| task.future.is_some()).map(|task| task.name);
            assert!(woken.is_ok(), "{:?} wait for ever", waiting.collect::<Vec<_>>());
            continue;
        }
        let chosen = match ready.len() {
            1 => 0,
            alternatives if enumerated.contains(&choices) => chooser.choose(alternatives),
            alternatives => choices % alternatives,
        };
        choices += usize::from(ready.len() > 1);
        ready[chosen].poll();
        // Renews tokio's budget, and wakes those that yielded.
        yield_now().await;
    }
}

/// Runs tasks: a driver, two calls in turn, a call that is dropped, a stream that is cloned,
/// someone who watches the state, and the end. Without a stream nothing but a request wakes
/// the driver.
async fn run(chooser: &mut Chooser, enumerated: Range<usize>, end: OrderEnd, is_streaming: bool) {
    let emulator = Emulator::builder().usb().pace(Pace::AtOnce).build();
    fastrand::seed(1);
    let builder = Sensor::builder().reconnect(false).depth(64);
    // It would wake an idle driver, too.
    let builder = builder.idle_probe(None);
    let (sensor, driver) = builder.build(emulator.clone());
    let window = Window::new(384..=384).unwrap();
    let (abort, aborted) = oneshot::channel::<()>();
    let (cancel, cancelled) = oneshot::channel::<()>();
    let (items, errors) = (Cell::new(0), RefCell::new(Vec::new()));
    let subscribed = Cell::new(false);
    let ended = Rc::new(RefCell::new(None));

    let driving = {
        let ended = Rc::clone(&ended);
        async move {
            tokio::select! {
                biased;
                Ok(()) = aborted => {}
                outcome = driver => *ended.borrow_mut() = Some(outcome),
            }
        }
    };
    let check = |outcome: Result<(), Error>| outcome.unwrap_or_else(|error| end.check(&error));
    let scanning = {
        let sensor = sensor.clone();
        async move {
            // The driver waits by the time of the second one.
            for _ in 0..2 {
                check(sensor.scan(window).await.map(drop));
            }
        }
    };
    let dropping = {
        let sensor = sensor.clone();
        async move {
            tokio::select! {
                biased;
                _ = cancelled => {}
                answer = sensor.scan(window) => check(answer.map(drop)),
            }
        }
    };
    let (items, errors, subscribed) = (&items, &errors, &subscribed);
    let reading = {
        let sensor = is_streaming.then(|| sensor.clone());
        async move {
            let Some(sensor) = sensor else { return };
            let mut stream = match sensor.scans(window, Rate::hz(10.0)).await {
                Ok(stream) => stream,
                Err(error) => return end.check(&error),
            };
            drop(sensor);
            subscribed.set(true);
            let mut next = 0;
            while let Some(item) = stream.next().await {
                match item {
                    Ok(scan) => {
                        assert_eq!(scan.sequence(), next, "{end:?}");
                        next += 1;
                    }
                    Err(error) => errors.borrow_mut().push(error),
                }
                items.set(items.get() + 1);
                if items.get() == 1 {
                    stream = stream.clone();
                }
                if end == OrderEnd::Drop && items.get() == 3 {
                    return;
                }
            }
        }
    };
    let watching = {
        let mut state = sensor.watch_state();
        async move {
            let closed = state.wait_for(|state| matches!(state, State::Closed { .. })).await;
            // If the driver was dropped, the state may go with its last handle.
            assert!(closed.is_ok(), "{end:?}");
        }
    };
    let ending = async move {
        match end {
            OrderEnd::Close => sensor.close().await,
            OrderEnd::Abort => {
                let _ = abort.send(());
            }
            OrderEnd::Unplug => emulator.unplug(),
            OrderEnd::Drop => drop(sensor),
        }
    };
    let cancelling = async move {
        let _ = cancel.send(());
    };
    execute(
        chooser,
        enumerated,
        vec![
            ("the driver", Box::pin(driving)),
            ("two calls", Box::pin(scanning)),
            ("a call that is dropped", Box::pin(dropping)),
            ("a stream", Box::pin(reading)),
            ("a watcher", Box::pin(watching)),
            ("the end", Box::pin(ending)),
            ("a drop", Box::pin(cancelling)),
        ],
    )
    .await;

    // A stream ends with its cause, once.
    let errors = errors.borrow();
    errors.iter().for_each(|error| end.check(error));
    let expected =
        usize::from(subscribed.get() && matches!(end, OrderEnd::Unplug | OrderEnd::Abort));
    assert_eq!(errors.len(), expected, "{end:?}: {errors:?}");
    match (end, &*ended.borrow()) {
        (OrderEnd::Close | OrderEnd::Drop, Some(Ok(()))) | (OrderEnd::Abort, None) => {}
        (OrderEnd::Unplug, Some(Err(error))) => end.check(error),
        (_, outcome) => panic!("{end:?}: the driver has ended with {outcome:?}"),
    }
}

#[test]
fn every_order_of_tasks_answers_each_call() {
    let length = setting("SCIP_ORDERS").unwrap_or(2);
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().unwrap();
    for (end, is_streaming) in [
        (OrderEnd::Close, true),
        (OrderEnd::Abort, true),
        (OrderEnd::Unplug, true),
        (OrderEnd::Drop, true),
        (OrderEnd::Close, false),
        (OrderEnd::Drop, false),
    ] {
        let mut runs = 0_u64;
        for start in 0..CHOICES {
            let mut chooser = Chooser::default();
            loop {
                runs += 1;
                let enumerated = start..start + length;
                runtime.block_on(run(&mut chooser, enumerated, end, is_streaming));
                if !chooser.advance() {
                    break;
                }
            }
        }
        println!("{end:?}, {}: {runs} orders", if is_streaming { "a stream" } else { "no stream" });
    }
}
