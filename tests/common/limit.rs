//! A time limit for every test, so that none waits for ever. A test that exceeds it
//! ends the whole executable with an error that names the test, because nothing less
//! ends a blocked thread. Every helper that makes a sensor, a port or a process calls
//! [`limit`].

use std::collections::HashMap;
use std::io::{Write, stderr};
use std::sync::{LazyLock, Mutex};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

/// Time limit, far more than any test takes between two calls of [`limit`], even on a machine with
/// ten times the usual load. An emulated processor needs more.
static LIMIT: LazyLock<Duration> = LazyLock::new(|| {
    let minutes = std::env::var("SCIP_TEST_LIMIT_MINUTES");
    Duration::from_secs(60 * minutes.map_or(10, |minutes| minutes.parse().unwrap()))
});

type Deadlines = Mutex<HashMap<ThreadId, (String, Instant)>>;

/// Name and deadline of each running test, by thread.
static DEADLINES: LazyLock<Deadlines> = LazyLock::new(|| {
    thread::spawn(watch);
    Mutex::default()
});

thread_local! {
    static TEST: Test = Test(thread::current().id());
}

/// The test that runs on a thread. Dropped when the thread, and so the test, ends.
struct Test(ThreadId);

impl Drop for Test {
    fn drop(&mut self) {
        DEADLINES.lock().unwrap().remove(&self.0);
    }
}

/// Allows the test of this thread ten more minutes.
pub(crate) fn limit() {
    let name = thread::current().name().unwrap_or("(unnamed)").to_owned();
    TEST.with(|test| DEADLINES.lock().unwrap().insert(test.0, (name, Instant::now() + *LIMIT)));
}

fn watch() {
    loop {
        thread::sleep(Duration::from_secs(1));
        let now = Instant::now();
        if let Some((name, _)) = DEADLINES.lock().unwrap().values().find(|(_, end)| *end < now) {
            // `eprintln!` would be captured with the output of the test that began first.
            let _ = writeln!(stderr(), "\nthe test {name} has taken more than {:?}", *LIMIT);
            std::process::exit(101);
        }
    }
}
