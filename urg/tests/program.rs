//! Runs the program and reads its output.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
#[cfg(unix)]
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

#[cfg(unix)]
use tokio::signal::unix::{SignalKind, signal};

use crate::limit::limit;

/// More than any step here takes.
pub(crate) const STEP_LIMIT: Duration = Duration::from_secs(60);

/// Commands that `urg help` lists.
pub(crate) const COMMANDS: &[&str] = &[
    "list",
    "info",
    "scan",
    "stream",
    "view",
    "record",
    "repair",
    "serve",
    "check",
    "laser",
    "baud",
    "reboot",
    "emulate",
    "completions",
];

const URG: &str = env!("CARGO_BIN_EXE_urg");

/// Limits the time of the test, and prepares this process for its children.
fn prepare() {
    limit();
    #[cfg(unix)]
    reset_hangup();
}

/// Starts every child process with SIGHUP at its default. Under `nohup` this process
/// ignores SIGHUP, and a child inherits that; a handled signal is reset to its default in
/// a child.
#[cfg(unix)]
fn reset_hangup() {
    static HANDLER: LazyLock<()> = LazyLock::new(|| {
        let install = || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
            runtime.unwrap().block_on(async { signal(SignalKind::hangup()).map(drop) }).unwrap();
        };
        // A runtime cannot be dropped inside another one.
        thread::spawn(install).join().unwrap();
    });
    LazyLock::force(&HANDLER);
}

/// Returns the program with these arguments.
pub(crate) fn program(arguments: &str) -> Command {
    prepare();
    let mut command = Command::new(URG);
    command.args(arguments.split_whitespace()).env_remove("RUST_LOG");
    command
}

/// Returns a shell that runs `script`, in which `$urg` is the program.
pub(crate) fn shell(script: &str) -> Command {
    prepare();
    let mut command = Command::new("sh");
    command.args(["-c", script]).env("urg", URG).env_remove("RUST_LOG");
    command
}

/// Output of a program that has ended.
pub(crate) struct ProgramOutput {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs a command to its end, without input, for as long as a step may take.
pub(crate) fn output_of(mut command: Command) -> ProgramOutput {
    let piped = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = piped.spawn().unwrap();
    let id = child.id();
    let (sender, ended) = channel();
    thread::spawn(move || sender.send(child.wait_with_output()));
    let Ok(output) = ended.recv_timeout(STEP_LIMIT) else {
        send(id, "KILL");
        panic!("{command:?} does not end");
    };
    let output = output.unwrap();
    ProgramOutput {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// Runs the program, which must end with this exit code.
pub(crate) fn run(arguments: &str, exit_code: i32) -> ProgramOutput {
    let output = output_of(program(arguments));
    assert_eq!(output.code, Some(exit_code), "{arguments}: {}", output.stderr);
    output
}

/// Runs the program, which must fail, and returns its one line of error.
pub(crate) fn failure(arguments: &str) -> String {
    let output = run(arguments, 1);
    assert_eq!(output.stdout, "");
    assert_eq!(output.stderr.lines().count(), 1, "{}", output.stderr);
    assert!(output.stderr.starts_with("urg: "), "{}", output.stderr);
    output.stderr
}

/// A running program, killed if the test fails meanwhile.
pub(crate) struct Running {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<Receiver<String>>,
    stderr: Receiver<String>,
}

impl Running {
    pub(crate) fn start(arguments: &str) -> Self {
        let mut running = Self::start_unread(arguments);
        running.read();
        running
    }

    /// Starts the program with a standard output that is not read.
    pub(crate) fn start_unread(arguments: &str) -> Self {
        Self::spawn(program(arguments))
    }

    /// Runs a command that becomes the program.
    pub(crate) fn spawn(mut command: Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let stderr = lines(child.stderr.take().unwrap());
        Self { stdin: child.stdin.take(), child, stdout: None, stderr }
    }

    /// Starts to read standard output.
    pub(crate) fn read(&mut self) {
        self.stdout = self.child.stdout.take().map(lines);
    }

    /// Reads the next line of standard output.
    pub(crate) fn line(&mut self) -> String {
        next(self.stdout.as_ref().expect("standard output is not read"))
    }

    /// Reads the next line of standard error.
    pub(crate) fn notice(&mut self) -> String {
        next(&self.stderr)
    }

    /// Reads standard output to its end.
    pub(crate) fn rest(&mut self) -> Vec<String> {
        self.stdout.take().map(|lines| all(&lines)).unwrap_or_default()
    }

    /// Presses Enter.
    pub(crate) fn enter(&mut self) {
        self.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
    }

    /// Closes the pipe of standard output.
    pub(crate) fn close_pipe(&mut self) {
        drop((self.child.stdout.take(), self.stdout.take()));
    }

    /// Sends a signal such as `INT`.
    pub(crate) fn signal(&self, signal: &str) {
        send(self.child.id(), signal);
    }

    /// Returns the memory that it has allocated and used, without its code (Linux).
    pub(crate) fn memory_kib(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let size = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
        size.split_whitespace().next()?.parse().ok()
    }

    /// Waits for the program's end, and returns the rest of standard error.
    pub(crate) fn end(mut self) -> (ExitStatus, Vec<String>) {
        // Standard error ends with the program.
        let notices = all(&self.stderr);
        (self.child.wait().unwrap(), notices)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal such as `INT` to a process.
pub(crate) fn send(id: u32, signal: &str) {
    let kill = Command::new("kill").args(["-s", signal, &id.to_string()]).status();
    assert!(kill.unwrap().success());
}

fn lines(stream: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    thread::spawn(move || {
        for line in BufReader::new(stream).lines() {
            if sender.send(line.unwrap()).is_err() {
                return;
            }
        }
    });
    receiver
}

fn next(lines: &Receiver<String>) -> String {
    match lines.recv_timeout(STEP_LIMIT) {
        Ok(line) => line,
        Err(RecvTimeoutError::Timeout) => panic!("no line came"),
        Err(RecvTimeoutError::Disconnected) => panic!("the program ended"),
    }
}

/// Reads all lines to the end.
fn all(lines: &Receiver<String>) -> Vec<String> {
    let mut all = Vec::new();
    loop {
        match lines.recv_timeout(STEP_LIMIT) {
            Ok(line) => all.push(line),
            Err(RecvTimeoutError::Disconnected) => return all,
            Err(RecvTimeoutError::Timeout) => panic!("the program does not end: {all:?}"),
        }
    }
}

/// An emulated sensor in its own process, and its PORT.
pub(crate) struct Emulated {
    /// Declared, and so dropped, before the program.
    _link: PortLink,
    pub(crate) running: Running,
    pub(crate) port: String,
    /// A time before its first revolution.
    pub(crate) began: Instant,
}

impl Emulated {
    /// Runs `urg emulate`, and waits until it serves.
    pub(crate) fn start(arguments: &str) -> Self {
        let began = Instant::now();
        let mut running = Running::start(&format!("emulate {arguments}"));
        let notice = running.notice();
        let (_, port) = notice.rsplit_once(", on ").unwrap_or_else(|| panic!("{notice}"));
        let port = port.to_owned();
        Self { _link: PortLink(port.clone()), running, port, began }
    }
}

/// Link to a terminal, which a killed program leaves behind. A program that still looks for the
/// sensor would find the next terminal of that number there, which is another test's.
struct PortLink(String);

impl Drop for PortLink {
    fn drop(&mut self) {
        if std::fs::symlink_metadata(&self.0).is_ok_and(|link| link.is_symlink()) {
            let _ = std::fs::remove_file(&self.0);
        }
    }
}

/// A path of a file that does not exist yet, removed at the end.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        Self::new_with(name, "")
    }

    fn new_with(name: &str, extension: &str) -> Self {
        // Two tests that chose the same name run at once.
        static MADE: AtomicUsize = AtomicUsize::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let name = format!("urg-{name}-{}-{number}{extension}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }

    /// Returns a path for a recording.
    pub(crate) fn mcap(name: &str) -> Self {
        Self::new_with(name, ".mcap")
    }

    /// Makes a pipe with the name of a recording.
    pub(crate) fn pipe(name: &str) -> Self {
        let pipe = Self::mcap(name);
        assert!(Command::new("mkfifo").arg(pipe.path()).status().unwrap().success());
        pipe
    }

    pub(crate) fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
