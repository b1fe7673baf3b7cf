//! `urg serve` under clients that are many, slow, or never read: others are served, and
//! its memory stays small.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::program::STEP_LIMIT;
use super::web::{Served, scan};

#[test]
fn viewers_are_limited_and_the_oldest_of_the_address_with_most_is_closed() {
    let served = Served::start("emulated");
    let mut viewers: Vec<_> = (0..33).map(|_| served.get("/scans")).collect();
    assert!(viewers.iter().all(|viewer| viewer.status == 200));
    assert_eq!(served.json("/state")["viewers"], 32);
    scan(&viewers[32].line().unwrap());
    // The first one is closed, somewhere in a line or between two.
    let oldest = viewers.remove(0);
    assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| oldest.text())).is_err());
}

/// The longest times for `/health` and for a first scan.
const HEALTH_LIMIT: Duration = Duration::from_secs(2);
const SCAN_LIMIT: Duration = Duration::from_secs(5);

/// Asserts that a supervisor and a new viewer are served while others misuse the server.
fn is_served_in_time(served: &Served) {
    for _ in 0..5 {
        let asked = Instant::now();
        assert_eq!(served.get("/health").status, 200);
        assert!(asked.elapsed() < HEALTH_LIMIT, "{:?}", asked.elapsed());
    }
    let asked = Instant::now();
    let mut viewer = served.get("/scans?max=20");
    assert_eq!(viewer.status, 200);
    for n in 0..20 {
        scan(&viewer.line().unwrap());
        assert!(n > 0 || asked.elapsed() < SCAN_LIMIT, "{:?}", asked.elapsed());
    }
}

#[test]
fn clients_that_send_their_request_byte_by_byte_block_no_other() {
    let served = Served::start("emulated");
    served.health(200);
    let before = served.running.memory_kib();
    let mut slow: Vec<_> = (0..300).map(|_| TcpStream::connect(&served.address).unwrap()).collect();
    for byte in b"GET /health HT" {
        // Those that were closed in favour of others are gone by now.
        slow.retain(|mut client| client.write_all(&[*byte]).is_ok());
    }
    assert!(slow.len() >= 100, "{} are still open", slow.len());
    is_served_in_time(&served);
    has_grown_by_less_than(&served, before, 1024);
}

#[test]
fn clients_that_never_read_their_scans_block_no_other() {
    let served = Served::start("emulated");
    served.health(200);
    let before = served.running.memory_kib();
    let clients = (0..200).map(|_| {
        let mut client = TcpStream::connect(&served.address).unwrap();
        let host = &served.address;
        write!(client, "GET /scans HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        client
    });
    let _clients: Vec<_> = clients.collect();
    is_served_in_time(&served);
    has_grown_by_less_than(&served, before, 1536);
}

/// Asserts that the memory of a server has not grown much since it was `before`.
fn has_grown_by_less_than(served: &Served, before: Option<u64>, limit_kib: u64) {
    let grown =
        served.running.memory_kib().zip(before).map(|(now, before)| now.saturating_sub(before));
    assert!(grown.is_none_or(|grown| grown < limit_kib), "{grown:?} KiB");
}

#[test]
fn a_burst_of_connections_waits_for_a_server_that_has_no_time() {
    let served = Served::start("emulated");
    served.running.signal("STOP");
    let address = served.address.parse().unwrap();
    // The system tries again after a second if there is no room.
    let limit = Duration::from_millis(900);
    let clients = (0..300).map(|_| TcpStream::connect_timeout(&address, limit));
    let clients: Result<Vec<_>, _> = clients.collect();
    served.running.signal("CONT");
    assert_eq!(clients.unwrap().len(), 300);
}

#[test]
fn a_connection_is_closed_after_its_response() {
    let served = Served::start("emulated");
    let mut client = TcpStream::connect(&served.address).unwrap();
    client.set_read_timeout(Some(STEP_LIMIT)).unwrap();
    write!(client, "GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut response = String::new();
    client.read_to_string(&mut response).unwrap();
    assert!(response.contains("connection: close\r\n"), "{response}");
    assert_eq!(response.matches("HTTP/1.1 200 OK").count(), 1, "{response}");
}
