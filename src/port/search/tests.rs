//! Tests of the search, on ports in memory.

use std::io;

use super::*;
use futures::FutureExt;

/// Ports whose nth opening has the result of the nth letter of their plan: `o` opens, `b`
/// is busy, `d` is denied, `e` fails, `g` is gone, `h` hangs for 3 s. The last letter repeats.
struct Fake {
    /// When the last port appears.
    appears: Instant,
    listed: Vec<(&'static str, &'static str)>,
    opened: Vec<String>,
    hung: Vec<(String, Instant)>,
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
        self.hung.retain(|(_, until)| Instant::now() < *until);
        listed.retain(|path| self.hung.iter().all(|(hung, _)| hung != path));
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
            Some('h') => {
                self.hung.push((port, Instant::now() + Duration::from_secs(3)));
                std::future::pending().await
            }
            _ => Err(ErrorKind::NoSuchPort { port }.into()),
        }
    }
}

fn search(listed: &[(&'static str, &'static str)]) -> Search<Fake> {
    let (listed, appears) = (listed.to_vec(), Instant::now());
    let fake = Fake { listed, opened: Vec::new(), hung: Vec::new(), listings: 0, appears };
    Search::new("H0713090".to_owned(), fake)
}

async fn next(search: &mut Search<Fake>) -> String {
    match search.next_port().await {
        Ok(port) => port,
        Err(error) => match error.kind() {
            ErrorKind::NoSuchSensor { serial_number, .. } => format!("no {serial_number}"),
            _ => error.to_string(),
        },
    }
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
    assert_eq!(start.elapsed(), Duration::from_secs(3));
}

#[tokio::test(start_paused = true)]
async fn o25_a_hanging_port_spares_the_others() {
    let mut search = search(&[("a", "h"), ("b", "h"), ("c", "o")]);
    let start = Instant::now();
    assert_eq!(next(&mut search).await, "c");
    assert_eq!(start.elapsed(), 2 * OPEN_LIMIT);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_is_found_soon_after_it_takes_bytes_again() {
    for after in (0..20_000).step_by(50).map(Duration::from_millis) {
        let until = Instant::now() + after;
        let mut search = search(&[("used", "b"), ("hung", "o")]);
        loop {
            if search.next_port().await.is_ok() {
                // The driver waits for an answer.
                let answer = tokio::time::sleep_until(until);
                if timeout(Duration::from_secs(5), answer).await.is_ok() {
                    break;
                }
                // Closing the port hangs as long.
                search.ports.hung.push(("hung".to_owned(), until));
            } else {
                let _ = timeout(Duration::from_secs(1), search.wait_for_port()).await;
            }
        }
        assert!(until.elapsed() <= LISTING_INTERVAL, "{after:?}: {:?}", until.elapsed());
    }
}
