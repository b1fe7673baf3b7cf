//! A limit on the time of every test, so that none waits for ever. A test that
//! takes longer ends the whole executable with an error that names it: nothing
//! else can end a thread that is blocked. Whatever makes a sensor, a port or a
//! process for a test calls [`limit`].

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

/// Far more than any test takes between two calls of [`limit`], also on a
/// machine that is ten times as busy as usual.
const LIMIT: Duration = Duration::from_secs(600);

type Deadlines = Mutex<HashMap<ThreadId, (String, Instant)>>;

/// The names and deadlines of the tests that run, by thread.
static DEADLINES: LazyLock<Deadlines> = LazyLock::new(|| {
    thread::spawn(watch);
    Mutex::default()
});

thread_local! {
    static TEST: Test = Test(thread::current().id());
}

/// A test on a thread of its own; it is over when the thread ends.
struct Test(ThreadId);

impl Drop for Test {
    fn drop(&mut self) {
        DEADLINES.lock().unwrap().remove(&self.0);
    }
}

/// From now on the test of this thread may take ten minutes.
pub(crate) fn limit() {
    let name = thread::current().name().unwrap_or("of no name").to_owned();
    TEST.with(|test| DEADLINES.lock().unwrap().insert(test.0, (name, Instant::now() + LIMIT)));
}

fn watch() {
    loop {
        thread::sleep(Duration::from_secs(1));
        let now = Instant::now();
        if let Some((name, _)) = DEADLINES.lock().unwrap().values().find(|(_, end)| *end < now) {
            eprintln!("\nthe test {name} waits or works for more than {LIMIT:?}");
            std::process::exit(101);
        }
    }
}
