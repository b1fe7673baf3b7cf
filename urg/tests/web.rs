//! `urg serve` over real sockets: its pages, streams and limits.

use std::collections::HashMap;
use std::io::Read;
use std::net::TcpStream;
use std::process::Command;
use std::time::Instant;

use serde_json::Value;
use tokio::runtime::Runtime;
use urg_emulator::{Emulator, Fault, Faults};

use super::formats::{check, event, values};
use super::http::{Client, HttpResponse};
use super::program::{Emulated, Running, STEP_LIMIT, Scratch, failure};
use super::slow_clients::is_watched_in_time;

/// A running `urg serve`, and its address.
pub(super) struct Served {
    pub(super) running: Running,
    pub(super) address: String,
}

impl Served {
    pub(super) fn start(arguments: &str) -> Self {
        let mut running = Running::start(&format!("serve {arguments} --listen 0"));
        let mut notice = running.notice();
        // On a busy machine a recording is not read at once, which the program says first.
        while notice.starts_with("urg: reading ") {
            notice = running.notice();
        }
        Self::announced(running, &notice)
    }

    pub(super) fn announced(running: Running, notice: &str) -> Self {
        let address = notice.split('/').nth(2).unwrap_or_else(|| panic!("{notice}")).to_owned();
        assert!(address.starts_with("127.0.0.1:"), "{notice}");
        Self { running, address }
    }

    pub(super) fn client(&self) -> Client<'_> {
        Client { address: &self.address, host: &self.address, accept: "*/*" }
    }

    pub(super) fn get(&self, path: &str) -> HttpResponse {
        self.client().get(path)
    }

    pub(super) fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.get(path).text()).unwrap()
    }

    /// Returns the state of the first sensor.
    pub(super) fn state(&self) -> Value {
        self.json("/state")["sensors"][0].take()
    }

    /// Requests `/health` until it has this status.
    pub(super) fn health(&self, status: u16) -> Value {
        let deadline = Instant::now() + STEP_LIMIT;
        loop {
            let response = self.get("/health");
            let seen = response.status;
            let health: Value = serde_json::from_str(&response.text()).unwrap();
            if seen == status {
                return health;
            }
            assert!(Instant::now() < deadline, "no {status} but {seen}: {health}");
        }
    }
}

pub(super) fn scan(line: &str) -> Value {
    let scan: Value = serde_json::from_str(line).unwrap();
    check(&scan);
    scan
}

#[test]
fn the_page_refers_to_no_other_address() {
    let served = Served::start("emulated");
    let response = served.get("/");
    assert_eq!(
        (response.status, response.header("content-type")),
        (200, "text/html; charset=utf-8")
    );
    let policy = response.header("content-security-policy").to_owned();
    for part in ["default-src 'none'", "connect-src 'self'", "frame-ancestors 'none'"] {
        assert!(policy.contains(part), "{policy}");
    }
    assert!(!policy.contains("unsafe") && !policy.contains("http") && !policy.contains('*'));
    assert_eq!(response.header("x-content-type-options"), "nosniff");
    assert!(!response.has("access-control-allow-origin"));

    let page = response.text();
    // It waits in the system's buffer of 64 KiB for a client that does not read.
    assert!(page.len() < 60_000, "{}", page.len());
    let (_, nonce) = policy.split_once("'nonce-").unwrap();
    let nonce = nonce.split('\'').next().unwrap();
    assert_eq!(page.matches(&format!("nonce=\"{nonce}\"")).count(), 2);
    assert_eq!(page.matches("<script").count(), 1);
    assert_eq!(page.matches("<style").count(), 1);
    // The XML name of SVG, in the icon, is not fetched.
    let page = page.replace("http://www.w3.org/2000/svg", "");
    for word in ["http:", "https:", " src=", "@import", "url(", "{nonce}", "{style}", "{script}"] {
        assert!(!page.contains(word), "{word}");
    }
    assert_eq!(page.matches("href=").count(), page.matches("href=\"data:").count());
    assert!(!served.get("/").text().contains(nonce), "the nonce is the same for two requests");
}

#[test]
fn scans_come_as_urg_stream_writes_them() {
    let served = Served::start("emulated --from -90deg --to 90deg --cluster 2");
    let mut response = served.get("/scans?max=3");
    assert_eq!((response.status, response.header("content-type")), (200, "application/x-ndjson"));
    // Otherwise nginx holds each scan until the next one. `proxy.py` measures it.
    assert_eq!(response.header("x-accel-buffering"), "no");
    // Otherwise HAProxy's `compression` holds most scans until the next one, and Express's all.
    assert_eq!(response.header("cache-control"), "no-store, no-transform");
    let mut next = None;
    for _ in 0..3 {
        let scan = scan(&response.line().unwrap());
        assert_eq!(scan["cluster"], 2);
        let sequence = scan["sequence"].as_u64().unwrap();
        assert_eq!(sequence, next.unwrap_or(sequence));
        next = Some(sequence + 1);
    }
    assert_eq!(response.line(), None, "more than the three requested scans");
}

#[test]
fn the_state_has_a_rate_after_two_scans() {
    let served = Served::start("emulated");
    let mut response = served.get("/scans");
    (0..2).for_each(|_| drop(scan(&response.line().unwrap())));
    let state = served.state();
    assert!(state["stats"].as_object().unwrap().contains_key("motor"), "{state}");
    assert!(state["reached"].as_f64().unwrap() > 0.0, "{state}");
}

#[test]
fn scans_come_as_server_sent_events_on_request() {
    let served = Served::start("emulated");
    let client = Client { accept: "text/event-stream", ..served.client() };
    let mut response = client.get("/scans?max=2");
    assert_eq!((response.status, response.header("content-type")), (200, "text/event-stream"));
    for _ in 0..2 {
        let line = response.line().unwrap();
        scan(line.strip_prefix("data: ").unwrap());
        assert_eq!(response.line().unwrap(), "");
    }
    assert_eq!(response.line(), None);
}

#[test]
fn two_viewers_get_the_same_scans_and_cost_one() {
    let served = Served::start("emulated");
    let mut viewers = [served.get("/scans?max=20"), served.get("/scans?max=20")];
    let mut seen = [HashMap::new(), HashMap::new()];
    for _ in 0..20 {
        for (viewer, seen) in viewers.iter_mut().zip(&mut seen) {
            let scan = scan(&viewer.line().unwrap());
            seen.insert(scan["sequence"].as_u64().unwrap(), values(&scan));
        }
    }
    let [one, other] = seen;
    let both: Vec<_> = one.keys().filter(|sequence| other.contains_key(sequence)).collect();
    assert!(both.len() > 10, "only {both:?} reached both");
    for sequence in both {
        assert_eq!(one[sequence], other[sequence], "scan {sequence} differs between the two");
    }
    let stats = &served.json("/state")["sensors"][0]["stats"];
    assert_eq!(stats["schedules"].as_array().unwrap().len(), 1, "{stats}");
    let (polls, scans) = (stats["polls"].as_u64().unwrap(), stats["scans"].as_u64().unwrap());
    assert!(polls <= scans + 1, "{stats}");
}

#[test]
fn health_and_streams_report_a_replug() {
    let link = Scratch::new("health");
    let sensor = Emulated::start(&format!("--link {}", link.path()));
    let served = Served::start(link.path());
    let mut scans = served.get("/scans");
    scan(&scans.line().unwrap());
    assert_eq!(served.health(200)["status"], "ok");
    assert_eq!(served.state()["sensor"]["serial_number"], "H0713090");

    drop(sensor);
    let health = served.health(503);
    // Who comes late sees which sensor it was, and its last scan, if they ask for it.
    assert_eq!(served.state()["sensor"]["serial_number"], "H0713090");
    let mut old: Value = serde_json::from_str(&served.get("/scans?old").line().unwrap()).unwrap();
    assert_eq!(old.as_object_mut().unwrap().remove("old"), Some(true.into()));
    check(&old);
    assert_eq!(health["status"], "failing");
    assert!(health["sensors"][0]["why"].as_str().unwrap().contains("lost"), "{health}");
    assert_eq!(served.state()["link"], "disconnected");
    event("disconnected", || scans.line().unwrap());

    let _sensor = Emulated::start(&format!("--link {}", link.path()));
    event("reconnected", || scans.line().unwrap());
    served.health(200);
    assert_eq!(served.state()["link"], "connected");
}

/// Serves an emulated sensor on TCP, in threads of a runtime, and returns both it and the PORT.
pub(super) fn on_tcp(emulator: Emulator) -> (Runtime, String) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = listener.local_addr().unwrap();
    runtime.spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            // Ends with the test.
            let _ = emulator.serve(client).await;
        }
    });
    (runtime, format!("tcp://{address}?baud=750000"))
}

#[test]
fn health_fails_while_every_reply_is_malformed() {
    let emulator = Emulator::default();
    let (_runtime, port) = on_tcp(emulator.clone());
    let served = Served::start(&port);
    served.health(200);

    // One byte of each scan is lost. Fences are shorter, and are answered.
    emulator.set_faults(Faults::none().rate(1.0, Fault::Drop(700..701)));
    let health = served.health(503);
    let sensor = &health["sensors"][0];
    let why = sensor["why"].as_str().unwrap();
    assert!(why.starts_with("no scan for ") && why.contains("malformed"), "{health}");
    assert_eq!(
        (&sensor["link"], &served.state()["link"]),
        (&"connected".into(), &"connected".into())
    );
    assert_eq!(served.state()["stats"]["disconnects"], 0);

    emulator.set_faults(Faults::none());
    served.health(200);
}

#[test]
fn the_page_is_served_before_its_sensor_exists() {
    let link = Scratch::new("serve-waits");
    let served = Served::start(&format!("{} --wait", link.path()));
    let health = served.health(503);
    assert_eq!(health["sensors"][0]["link"], "waiting", "{health}");
    // The reason is there after the first attempt.
    let why = || served.health(503)["sensors"][0]["why"].as_str().unwrap().to_owned();
    while !why().contains("no port") {}
    assert_eq!(served.state()["sensor"], Value::Null);
    let mut scans = served.get("/scans?max=1");
    let _sensor = Emulated::start(&format!("--link {}", link.path()));
    scan(&scans.line().unwrap());
    served.health(200);
}

#[test]
fn a_slow_client_gets_the_newest_scans() {
    let link = Scratch::new("slow");
    let sensor = Emulated::start(&format!("--revolution 5ms --link {}", link.path()));
    let served = Served::start(&format!("{} --rate max", sensor.port));
    let mut slow = served.get("/scans");
    let first = scan(&slow.line().unwrap())["sequence"].as_u64().unwrap();
    // The system buffers far fewer scans for it.
    let mut quick = served.get("/scans?max=500");
    let mut newest = String::new();
    while let Some(line) = quick.line() {
        if line.contains("\"sequence\"") {
            newest = line;
        }
    }
    let last = scan(&newest)["sequence"].as_u64().unwrap();
    assert!(last >= first + 400);
    let mut before = first;
    loop {
        let line: Value = serde_json::from_str(&slow.line().unwrap()).unwrap();
        if line["event"] == "missed" {
            let missed = line["scans"].as_u64().unwrap();
            let next = scan(&slow.line().unwrap())["sequence"].as_u64().unwrap();
            assert_eq!(next, before + missed + 1);
            break;
        }
        // On a busy machine a poll may fail, and there is an event of it.
        before = line["sequence"].as_u64().unwrap_or(before);
        assert!(before < last, "all scans were kept for a slow client");
    }
}

#[test]
fn a_request_for_another_host_is_refused() {
    let served = Served::start("emulated");
    for host in ["evil.example", "evil.example:80", "robot.local"] {
        for path in ["/", "/scans", "/state", "/health"] {
            let response = Client { host, ..served.client() }.get(path);
            assert_eq!(response.status, 421, "{host} {path}");
        }
    }
    let near = ["", "localhost.evil.example:80", "127.0.0.1.evil.example", "::1.evil.example"];
    for host in near {
        assert_eq!(Client { host, ..served.client() }.get("/state").status, 421, "{host}");
    }
    let address = ["LOCALHOST:9", "localhost.", "127.0.0.1:80", "192.168.1.1", "[::1]:80", "[::2]"];
    let uname = Command::new("uname").arg("-n").output().unwrap();
    let name = String::from_utf8(uname.stdout).unwrap().trim().to_owned();
    for host in address.into_iter().chain([name.as_str(), &format!("{name}.local:80")]) {
        assert_eq!(Client { host, ..served.client() }.get("/state").status, 200, "{host}");
    }
}

#[test]
fn refused_requests_get_the_reason() {
    let served = Served::start("emulated");
    assert_eq!(served.get("/nothing").status, 404);
    for query in ["max=none", "max=0", "max=-1", "max=", "maximum=3", "max=1&rate=2"] {
        let response = served.get(&format!("/scans?{query}"));
        assert_eq!(response.status, 400, "{query}");
        assert!(response.text().contains("/scans?max=N"));
    }
    for query in ["max=2", "old&max=2"] {
        assert_eq!(served.get(&format!("/scans?{query}")).text().lines().count(), 2, "{query}");
    }
    let line = failure(&format!("serve emulated --listen {}", served.address));
    assert!(line.contains(&format!("cannot listen on {}", served.address)), "{line}");
}

#[test]
fn an_interrupt_ends_open_connections_and_the_program() {
    for signal in ["INT", "TERM"] {
        let served = Served::start("emulated");
        let mut streams = [served.get("/scans"), served.get("/scans")];
        for stream in &mut streams {
            scan(&stream.line().unwrap());
        }
        served.running.signal(signal);
        for mut stream in streams {
            // Reads a proper end of the body, or panics.
            while let Some(line) = stream.line() {
                scan(&line);
            }
        }
        let (status, notices) = served.running.end();
        assert_eq!((status.code(), notices), (Some(0), vec![]), "{signal}");
    }
}

#[test]
fn a_client_that_never_reads_does_not_delay_the_end() {
    let link = Scratch::new("unread-http");
    let sensor = Emulated::start(&format!("--revolution 5ms --link {}", link.path()));
    let served = Served::start(&format!("{} --rate max", sensor.port));
    let _stuck = served.get("/scans");
    // When this one has ended, the other one's buffers have long been full.
    served.get("/scans?max=1000").text();
    served.running.signal("INT");
    let (status, _) = served.running.end();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn a_network_page_accepts_only_given_names() {
    let mut running = Running::start("serve emulated --listen 0.0.0.0:0 --host robot.example");
    let notice = running.notice();
    let (_, port) = notice.split_once("http://0.0.0.0:").unwrap_or_else(|| panic!("{notice}"));
    let address = format!("127.0.0.1:{}", port.split('/').next().unwrap());
    assert!(running.notice().contains("there is no password"));
    for (host, status) in [("Robot.example:80", 200), ("evil.example", 421)] {
        let client = Client { address: &address, host, accept: "*/*" };
        assert_eq!(client.get("/state").status, status, "{host}");
    }
}

#[test]
fn streams_and_silent_clients_leave_places_to_short_requests() {
    let served = Served::start("emulated");
    let mut streams: Vec<_> = (0..448).map(|_| served.get("/scans")).collect();
    assert!(streams.iter().all(|stream| stream.status == 200));
    let refused = served.get("/scans");
    assert_eq!(refused.status, 503);
    assert_eq!(refused.text(), "448 clients read scans already: try again later\n");
    // All places are taken, and the first silent client gives way, before its 10 s are over.
    let mut silent: Vec<_> =
        (0..64).map(|_| TcpStream::connect(&served.address).unwrap()).collect();
    is_watched_in_time(&served);
    silent[0].set_read_timeout(Some(STEP_LIMIT)).unwrap();
    assert_eq!(silent[0].read(&mut [0]).unwrap(), 0);
    drop(streams.pop());
    // The server notices at the next scan.
    while served.get("/scans?max=1").status == 503 {}
}

#[test]
fn metrics_count_what_the_driver_counts() {
    let served = Served::start("emulated");
    served.health(200);
    let response = served.get("/metrics");
    assert_eq!(response.header("content-type"), "text/plain; version=0.0.4; charset=utf-8");
    let text = response.text();
    let value = |name: &str| -> f64 {
        let line = text.lines().find(|line| line.starts_with(&format!("{name} ")));
        line.unwrap_or_else(|| panic!("{name} in {text}"))
            .rsplit(' ')
            .next()
            .unwrap()
            .parse()
            .unwrap()
    };
    assert_eq!(value("urg_up"), 1.0);
    assert!(value("urg_scans_total") >= 1.0 && value("urg_scan_age_seconds") < 60.0, "{text}");
    assert_eq!(value("urg_poll_failures_total{cause=\"timeout\"}"), 0.0);
}
