//! [`Example`]: a program of `examples/` that runs.

#![allow(dead_code, reason = "not each executable of tests calls all of it")]

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Command, Stdio};

use crate::common::limit::limit;

/// An example that runs, and is killed when it is dropped.
pub(crate) struct Example {
    pub(crate) child: Child,
    lines: BufReader<ChildStdout>,
}

impl Example {
    pub(crate) fn run(name: &str, arguments: &[&str]) -> Self {
        Self::run_with(name, arguments, &[])
    }

    /// Runs it with these variables of the environment.
    pub(crate) fn run_with(name: &str, arguments: &[&str], variables: &[(&str, &OsStr)]) -> Self {
        limit();
        // `cargo test` builds them before it runs tests, into the folder beside theirs.
        let tests = std::env::current_exe().unwrap();
        let examples = tests.parent().unwrap().parent().unwrap().join("examples");
        let mut command = Command::new(examples.join(name));
        let child =
            command.args(arguments).envs(variables.iter().copied()).stdout(Stdio::piped()).spawn();
        // `cargo test --test it` does not build them.
        let mut child = child.expect("run `cargo build --workspace --examples` first");
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self { child, lines }
    }

    /// Returns the next line of its output.
    pub(crate) fn line(&mut self) -> String {
        let mut line = String::new();
        assert!(self.lines.read_line(&mut line).unwrap() > 0, "no more lines");
        line.trim_end().to_owned()
    }

    /// Returns the first line that contains `text`.
    pub(crate) fn line_with(&mut self, text: &str) -> String {
        std::iter::repeat_with(|| self.line()).find(|line| line.contains(text)).unwrap()
    }

    /// Waits for its end with success.
    pub(crate) fn end(mut self) {
        assert!(self.child.wait().unwrap().success());
    }
}

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the answer to a `GET` of an address such as `http://127.0.0.1:8081/nearest`, head
/// and body.
pub(crate) fn get(url: &str) -> String {
    request("GET", url)
}

/// Returns the answer to a request.
pub(crate) fn request(method: &str, url: &str) -> String {
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut client = TcpStream::connect(host).unwrap();
    write!(client, "{method} /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
        .unwrap();
    let mut answer = String::new();
    client.read_to_string(&mut answer).unwrap();
    answer
}

/// Asks until the answer contains `text`: the service may be waiting for its first scan.
pub(crate) fn get_until(url: &str, text: &str) -> String {
    std::iter::repeat_with(|| get(url)).find(|answer| answer.contains(text)).unwrap()
}

/// Returns the address at the end of a line.
pub(crate) fn address(line: &str) -> &str {
    line.rsplit(' ').next().unwrap()
}
