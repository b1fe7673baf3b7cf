//! The two processes that are observed, and samples of their memory, file descriptors and
//! threads (`/proc`).

use std::collections::HashMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::Path;
use std::process::Stdio;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};

/// Process of `library.rs`.
pub(crate) struct Library {
    pub(crate) process: Child,
    requests: ChildStdin,
    reports: Lines<BufReader<ChildStdout>>,
}

impl Library {
    pub(crate) async fn start(port: &Path, file: &Path) -> Self {
        let mut process = Command::new(std::env::current_exe().unwrap())
            .arg("library")
            .args([port, file])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let requests = process.stdin.take().unwrap();
        let reports = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, requests, reports }
    }

    /// Returns its counts by their names.
    pub(crate) async fn report(&mut self) -> HashMap<String, u64> {
        self.requests.write_all(b"\n").await.unwrap();
        self.counts().await.expect("a report")
    }

    /// Ends the process, and returns its last counts.
    pub(crate) async fn finish(self) -> HashMap<String, u64> {
        let Self { mut process, requests, mut reports } = self;
        drop(requests);
        let mut counts = HashMap::new();
        while let Some(line) = reports.next_line().await.unwrap() {
            counts.extend(parse(&line));
        }
        assert!(process.wait().await.unwrap().success(), "the process of the library failed");
        counts
    }

    async fn counts(&mut self) -> Option<HashMap<String, u64>> {
        let line = self.reports.next_line().await.unwrap()?;
        Some(parse(&line).collect())
    }
}

fn parse(line: &str) -> impl Iterator<Item = (String, u64)> {
    line.split_whitespace().map(|count| {
        let (name, value) = count.split_once('=').unwrap();
        (name.to_owned(), value.parse().unwrap())
    })
}

/// `urg serve`.
pub(crate) struct Server {
    pub(crate) process: Child,
    pub(crate) address: SocketAddr,
}

impl Server {
    pub(crate) async fn start(port: &Path) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_urg"))
            .arg("serve")
            .arg(port)
            .args(["--listen", "0"])
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let mut notices = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = loop {
            let notice = notices.next_line().await.unwrap().expect("the address");
            if let Some((_, rest)) = notice.split_once("http://") {
                break rest.split('/').next().unwrap().parse().unwrap();
            }
        };
        // Its reports about replugs, which are not needed, must not fill the pipe.
        tokio::spawn(async move { while let Ok(Some(_)) = notices.next_line().await {} });
        Self { process, address }
    }
}

/// Memory, file descriptors and threads of a process.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) resident_kib: u64,
    pub(crate) descriptors: u64,
    pub(crate) threads: u64,
}

impl Sample {
    pub(crate) const HEADER: &str = "    time  library: memory, files, threads  serve: memory, \
                                     files, threads  recorded, missed by streams  served";

    pub(crate) fn from_process(process: &Child) -> Self {
        let folder = format!("/proc/{}", process.id().expect("a process that runs"));
        let status = std::fs::read_to_string(format!("{folder}/status")).unwrap();
        let figure = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
            line.split_whitespace().next().unwrap().parse().unwrap()
        };
        Self {
            resident_kib: figure("VmRSS:"),
            descriptors: std::fs::read_dir(format!("{folder}/fd")).unwrap().count() as u64,
            threads: figure("Threads:"),
        }
    }
}

impl fmt::Display for Sample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { resident_kib, descriptors, threads } = self;
        write!(f, "{resident_kib:6} KiB {descriptors:3} {threads:3}")
    }
}
