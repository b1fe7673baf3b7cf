//! `urg serve` under clients that are many, slow, or never read: others are served, and
//! its memory stays small.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use super::program::STEP_LIMIT;
use super::web::{Served, scan};

/// Sends a request, closes that side, and reads to the end.
fn half_closed(served: &Served, path: &str) -> String {
    let mut client = TcpStream::connect(&served.address).unwrap();
    client.set_read_timeout(Some(STEP_LIMIT)).unwrap();
    write!(client, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    client.shutdown(Shutdown::Write).unwrap();
    let mut response = String::new();
    client.read_to_string(&mut response).unwrap();
    response
}

#[test]
fn a_half_closed_client_gets_its_response() {
    let served = Served::start("emulated");
    served.health(200);
    for _ in 0..20 {
        for path in ["/health", "/state", "/metrics", "/"] {
            let response = half_closed(&served, path);
            assert!(response.starts_with("HTTP/1.1 200 OK\r\n"), "{path}: {response:?}");
        }
    }
    let scans = half_closed(&served, "/scans?max=3");
    assert_eq!(scans.matches("\"sequence\":").count(), 3, "{scans}");
}

/// Longest times for `/health` and for a first scan.
const HEALTH_LIMIT: Duration = Duration::from_secs(2);
const SCAN_LIMIT: Duration = Duration::from_secs(5);

/// Asserts that a supervisor is served while others misuse the server.
pub(super) fn is_watched_in_time(served: &Served) {
    for _ in 0..5 {
        let asked = Instant::now();
        assert_eq!(served.get("/health").status, 200);
        assert!(asked.elapsed() < HEALTH_LIMIT, "{:?}", asked.elapsed());
    }
}

/// Asserts the same of a supervisor and a new viewer.
fn is_served_in_time(served: &Served) {
    is_watched_in_time(served);
    let asked = Instant::now();
    let mut viewer = served.get("/scans?max=20");
    assert_eq!(viewer.status, 200);
    for n in 0..20 {
        scan(&viewer.line().unwrap());
        assert!(n > 0 || asked.elapsed() < SCAN_LIMIT, "{:?}", asked.elapsed());
    }
}

#[test]
fn clients_that_send_byte_by_byte_block_no_other() {
    let served = Served::start("emulated");
    served.health(200);
    let mut slow: Vec<_> = (0..300).map(|_| TcpStream::connect(&served.address).unwrap()).collect();
    for byte in b"GET /health HT" {
        slow.retain(|mut client| client.write_all(&[*byte]).is_ok());
    }
    assert_eq!(slow.len(), 300, "some were closed before their time");
    is_served_in_time(&served);
    is_small(&served);
}

#[test]
fn clients_that_never_read_their_scans_block_no_other() {
    let served = Served::start("emulated");
    served.health(200);
    let clients = (0..200).map(|_| {
        let mut client = TcpStream::connect(&served.address).unwrap();
        let host = &served.address;
        write!(client, "GET /scans HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        client
    });
    let _clients: Vec<_> = clients.collect();
    is_served_in_time(&served);
    is_small(&served);
}

/// Asserts that the memory of a server under attack is limited.
fn is_small(served: &Served) {
    let used = served.running.memory_kib();
    assert!(used.is_none_or(|used| used < 32 * 1024), "{used:?} KiB");
}

#[test]
fn a_burst_of_connections_waits_for_the_server() {
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
