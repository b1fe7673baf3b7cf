//! Tests of the search, on ports in memory.

use std::collections::HashSet;
use std::io;
use std::sync::{Arc, Mutex};

use super::*;
use futures::FutureExt;
use futures::future::join_all;

/// Ports whose nth opening has the result of the nth letter of their plan: `o` opens, `b`
/// is busy, `d` is denied, `e` fails, `g` is gone, `h` hangs. The last letter repeats.
struct Fake {
    /// When the last port appears.
    appears: Instant,
    listed: Vec<(&'static str, &'static str)>,
    opened: Vec<String>,
    listings: usize,
}

impl Ports for Fake {
    type Port = String;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        self.listings += 1;
        let mut listed: Vec<_> = self.listed.iter().map(|(path, _)| (*path).to_owned()).collect();
        if Instant::now() < self.appears {
            listed.pop();
        }
        Ok(listed)
    }

    async fn open(&mut self, path: &str) -> Result<String, Error> {
        let tries = self.opened.iter().filter(|opened| *opened == path).count();
        self.opened.push(path.to_owned());
        let plan = self.listed.iter().find(|(listed, _)| *listed == path);
        let plan = plan.map_or("g", |(_, plan)| plan);
        let port = path.to_owned();
        match plan.chars().nth(tries).or(plan.chars().last()) {
            Some('o') => Ok(port),
            Some('b') => Err(ErrorKind::Busy { port }.into()),
            Some('d') => Err(ErrorKind::PermissionDenied { port, group: None }.into()),
            Some('e') => Err(Error::open(port, io::ErrorKind::PermissionDenied.into())),
            Some('h') => std::future::pending().await,
            _ => Err(ErrorKind::NoSuchPort { port }.into()),
        }
    }
}

/// Ports that several searches share. Each port is busy while a search holds it.
struct SharedPorts {
    count: usize,
    held: Arc<Mutex<HashSet<String>>>,
}

struct Held(String, Arc<Mutex<HashSet<String>>>);

impl Drop for Held {
    fn drop(&mut self) {
        self.1.lock().unwrap().remove(&self.0);
    }
}

impl Ports for SharedPorts {
    type Port = Held;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        Ok((0..self.count).map(|number| number.to_string()).collect())
    }

    async fn open(&mut self, path: &str) -> Result<Held, Error> {
        let port = path.to_owned();
        match self.held.lock().unwrap().insert(port.clone()) {
            true => Ok(Held(port, Arc::clone(&self.held))),
            false => Err(ErrorKind::Busy { port }.into()),
        }
    }
}

#[tokio::test(start_paused = true)]
async fn simultaneous_searches_each_find_a_sensor() {
    for (count, shift) in (2..=5).flat_map(|count| (0..count).map(move |shift| (count, shift))) {
        let held = Arc::default();
        let searches = (0..count).map(|sensor| {
            let own = ((sensor + shift) % count).to_string();
            let ports = SharedPorts { count, held: Arc::clone(&held) };
            let mut search = Search::new(own.clone(), ports);
            async move {
                loop {
                    let port = search.next_port().await?;
                    // Asks the sensor for its serial number.
                    sleep(Duration::from_millis(400)).await;
                    if port.0 == own {
                        return Ok::<_, Error>(port);
                    }
                }
            }
        });
        let found = join_all(searches).await;
        assert!(found.iter().all(Result::is_ok), "{count} sensors, moved by {shift}");
    }
}

fn search(listed: &[(&'static str, &'static str)]) -> Search<Fake> {
    let (listed, appears) = (listed.to_vec(), Instant::now());
    let fake = Fake { listed, opened: Vec::new(), listings: 0, appears };
    Search::new("H0713090".to_owned(), fake)
}

async fn next(search: &mut Search<Fake>) -> String {
    match search.next_port().await {
        Ok(port) => port,
        Err(error) => match error.kind() {
            ErrorKind::NoSuchSensor { serial_number } => format!("no {serial_number}"),
            _ => error.to_string(),
        },
    }
}

#[tokio::test(start_paused = true)]
async fn a_pass_opens_each_port_once() {
    let mut search = search(&[("a", "o"), ("b", "g"), ("c", "o")]);
    assert!(!search.has_more(), "no pass has begun");
    assert_eq!(next(&mut search).await, "a");
    assert!(search.has_more());
    assert_eq!(next(&mut search).await, "c");
    assert!(search.has_more(), "the next call says at once that none is left");
    assert_eq!(next(&mut search).await, "no H0713090");
    assert!(!search.has_more());
}

#[tokio::test(start_paused = true)]
async fn a_busy_port_is_retried_for_two_seconds() {
    let mut search = search(&[("a", "bbo"), ("b", "o"), ("c", "b")]);
    let start = Instant::now();
    assert_eq!(next(&mut search).await, "b");
    assert_eq!(start.elapsed(), Duration::ZERO, "others come first");
    assert_eq!(next(&mut search).await, "a");
    assert_eq!(start.elapsed(), LISTING_INTERVAL);
    assert_eq!(next(&mut search).await, "no H0713090");
    assert_eq!(start.elapsed(), LISTING_INTERVAL + BUSY_LIMIT);
}

#[tokio::test(start_paused = true)]
async fn dropped_calls_wait_for_a_busy_port_no_longer() {
    let mut search = search(&[("a", "b")]);
    let start = Instant::now();
    let call = Duration::from_millis(20);
    while timeout(call, search.next_port()).await.is_err() {
        assert!(start.elapsed() <= BUSY_LIMIT, "the wait begins again and again");
    }
    assert!(start.elapsed() >= BUSY_LIMIT);
}

#[tokio::test(start_paused = true)]
async fn a_port_that_appears_is_opened_soon() {
    let busy = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j"].map(|path| (path, "b"));
    for (plan, limit) in [("o", LISTING_INTERVAL), ("eo", 2 * LISTING_INTERVAL)] {
        let last = (BUSY_LIMIT - limit).as_millis() as u64;
        for after in (0..=last).step_by(10).map(Duration::from_millis) {
            let mut search = search(&[&busy[..], &[("new", plan)]].concat());
            search.ports.appears += after;
            let start = Instant::now();
            assert_eq!(next(&mut search).await, "new");
            assert!(start.elapsed() <= after + limit, "{after:?}: {:?}", start.elapsed());
            assert!(search.ports.listings <= 9, "{} listings", search.ports.listings);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn between_passes_only_a_new_port_is_told() {
    let mut search = search(&[("a", "e"), ("b", "e"), ("new", "o")]);
    search.ports.appears += Duration::from_secs(10);
    assert_eq!(next(&mut search).await, "no H0713090");
    // Dropped and called again, as by a driver that backs off.
    while timeout(Duration::from_secs(1), search.wait_for_port()).await.is_err() {
        assert_eq!(next(&mut search).await, "no H0713090");
    }
    assert!(search.ports.appears.elapsed() <= LISTING_INTERVAL);
    assert_eq!(next(&mut search).await, "new");
    let appears = search.wait_for_port();
    assert!(timeout(Duration::from_secs(10), appears).await.is_err(), "nothing is new");
}

#[tokio::test(start_paused = true)]
async fn a_forbidden_port_is_named_in_the_end() {
    let mut search = search(&[("a", "d"), ("b", "o")]);
    assert_eq!(next(&mut search).await, "b");
    let error = search.next_port().await.unwrap_err();
    assert!(matches!(error.kind(), ErrorKind::PermissionDenied { port, .. } if port == "a"));
    assert!(!search.has_more());
}

#[tokio::test(start_paused = true)]
async fn a_port_whose_opening_was_dropped_is_skipped() {
    let mut search = search(&[("a", "h"), ("b", "b"), ("c", "o")]);
    assert!(search.next_port().now_or_never().is_none());
    assert_eq!(next(&mut search).await, "c");
    // Dropped while it waited for the busy port, which is still retried.
    assert!(search.next_port().now_or_never().is_none());
    assert_eq!(next(&mut search).await, "no H0713090");
    assert!(!search.ports.opened.split_off(1).contains(&"a".to_owned()));
}

#[tokio::test(start_paused = true)]
async fn a_port_that_hangs_no_longer_is_opened() {
    let mut search = search(&[("a", "ho")]);
    let start = Instant::now();
    assert_eq!(next(&mut search).await, "a");
    assert_eq!(start.elapsed(), OPEN_LIMIT + LISTING_INTERVAL);
}

#[tokio::test(start_paused = true)]
async fn o25_a_hanging_port_spares_the_others() {
    let mut search = search(&[("a", "h"), ("b", "h"), ("c", "o")]);
    let start = Instant::now();
    assert_eq!(next(&mut search).await, "c");
    assert_eq!(start.elapsed(), 2 * OPEN_LIMIT);
}

/// A port whose sensor takes no bytes until a time, so that closing it hangs as long, beside one that
/// is always in use.
struct Hung {
    until: Instant,
    is_closing: bool,
}

impl Ports for Hung {
    type Port = ();

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        Ok(vec!["hung".to_owned(), "used".to_owned()])
    }

    async fn open(&mut self, path: &str) -> Result<(), Error> {
        match path == "hung" && !self.is_closing {
            true => Ok(()),
            false => Err(ErrorKind::Busy { port: path.to_owned() }.into()),
        }
    }

    fn one_hangs_no_longer(&mut self) -> bool {
        let is_closed = self.is_closing && Instant::now() >= self.until;
        self.is_closing &= !is_closed;
        is_closed
    }
}

#[tokio::test(start_paused = true)]
async fn a_sensor_is_found_soon_after_it_takes_bytes_again() {
    for after in (0..20_000).step_by(50).map(Duration::from_millis) {
        let until = Instant::now() + after;
        let mut search = Search::new(String::new(), Hung { until, is_closing: false });
        loop {
            if search.next_port().await.is_ok() {
                // The driver waits for an answer.
                let answer = tokio::time::sleep_until(until);
                if timeout(Duration::from_secs(5), answer).await.is_ok() {
                    break;
                }
                search.ports.is_closing = true;
            } else {
                let _ = timeout(Duration::from_secs(1), search.wait_for_port()).await;
            }
        }
        assert!(until.elapsed() <= LISTING_INTERVAL, "{after:?}: {:?}", until.elapsed());
    }
}
