//! `urg view` on a real terminal: it draws, and restores the terminal at its end.

use std::fs::{File, OpenOptions};
use std::process::Stdio;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, Command};
use tokio_serial::{SerialPort, SerialStream};

use super::program::{Emulated, STEP_LIMIT, Scratch, program, run, send};

/// A terminal, and the program that draws on it.
struct Terminal {
    /// End that a user sees and types on.
    user: SerialStream,
    /// Held, so that the terminal stays when the program has ended.
    line: SerialStream,
    urg: Child,
    settings: String,
    drawn: String,
}

impl Terminal {
    /// Starts the program with standard error closed off.
    async fn start(arguments: &str) -> Self {
        Self::start_with(arguments, |_| Stdio::null()).await
    }

    /// Starts the program; `stderr` returns its standard error for the terminal's path.
    async fn start_with(arguments: &str, stderr: impl FnOnce(&str) -> Stdio) -> Self {
        let (user, line) = SerialStream::pair().unwrap();
        let path = line.name().unwrap();
        stty(&path, &["rows", "24", "cols", "80"]).await;
        let settings = stty(&path, &["-g"]).await;
        let urg = Command::from(program(arguments))
            .env("TERM", "xterm-256color")
            .stdin(open(&path))
            .stdout(open(&path))
            .stderr(stderr(&path))
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        Self { user, line, urg, settings, drawn: String::new() }
    }

    /// Waits until all these texts were drawn, in this order.
    async fn until(&mut self, texts: &[&str]) {
        let read = async {
            let mut from = 0;
            for text in texts {
                while !self.drawn[from..].contains(text) {
                    let mut bytes = [0; 4096];
                    let count = self.user.read(&mut bytes).await.unwrap();
                    self.drawn.push_str(&String::from_utf8_lossy(&bytes[..count]));
                }
                from += self.drawn[from..].find(text).unwrap() + text.len();
            }
        };
        let waited = tokio::time::timeout(STEP_LIMIT, read).await;
        waited.unwrap_or_else(|_| panic!("{texts:?} not in {:?}", self.drawn));
    }

    /// Waits until all these texts were drawn, in whatever order: a screen is drawn as its
    /// changes, and what is known first depends on the machine.
    async fn until_each(&mut self, texts: &[&str]) {
        for text in texts {
            self.until(&[text]).await;
        }
    }

    /// Waits for the end, and asserts that the terminal is as before.
    async fn end(mut self) -> Option<i32> {
        self.until(&["\x1b[?1049h", "\x1b[?1049l", "\x1b[?25h"]).await;
        let status = self.urg.wait().await.unwrap();
        let path = self.line.name().unwrap();
        assert_eq!(stty(&path, &["-g"]).await, self.settings);
        status.code()
    }
}

fn open(path: &str) -> File {
    OpenOptions::new().read(true).write(true).open(path).unwrap()
}

async fn stty(path: &str, arguments: &[&str]) -> String {
    let output = Command::new("stty").args(arguments).stdin(open(path)).output().await.unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[tokio::test]
async fn keys_work_and_quitting_restores_the_terminal() {
    let mut terminal = Terminal::start("view emulated").await;
    terminal.until_each(&["URG-04LX", "quit"]).await;
    terminal.user.write_all(b"?").await.unwrap();
    terminal.until(&["detection"]).await;
    terminal.user.write_all(b"q").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
}

/// A stream of SCIP 2 has intervals between its scans, which are no latency of a reply.
#[tokio::test]
async fn a_latency_is_shown_only_for_polls() {
    let ust = Emulated::start("--model ust-10lx --tcp 0");
    let mut terminal = Terminal::start(&format!("view {}", ust.port)).await;
    // All but the blanks between these words was drawn.
    terminal.until_each(&["UST-10LX", "rate", "lost", "1081"]).await;
    assert!(!terminal.drawn.contains("latency"), "{}", terminal.drawn);
    let mut terminal = Terminal::start("view emulated").await;
    terminal.until_each(&["URG-04LX", "rate", "latency", "682"]).await;
}

/// Waits until the program is stopped (Linux).
#[cfg(target_os = "linux")]
async fn stopped(id: u32) {
    let is_stopped = || {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
        stat.rsplit(')').next().unwrap().trim_start().starts_with('T')
    };
    let deadline = std::time::Instant::now() + STEP_LIMIT;
    while !is_stopped() {
        assert!(std::time::Instant::now() < deadline, "it does not stop");
        tokio::task::yield_now().await;
    }
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn ctrl_z_restores_the_terminal() {
    let mut terminal = Terminal::start("view emulated").await;
    terminal.until_each(&["URG-04LX", "quit"]).await;
    let id = terminal.urg.id().unwrap();
    let path = terminal.line.name().unwrap();
    for round in 0..2 {
        match round {
            0 => terminal.user.write_all(b"\x1a").await.unwrap(),
            _ => send(id, "TSTP"),
        }
        terminal.until(&["\x1b[?1049l", "\x1b[?25h"]).await;
        stopped(id).await;
        assert_eq!(stty(&path, &["-g"]).await, terminal.settings);
        terminal.drawn.clear();
        send(id, "CONT");
        // All of the picture is drawn again.
        terminal.until(&["\x1b[?1049h"]).await;
        terminal.until_each(&["URG-04LX", "quit"]).await;
    }
    terminal.user.write_all(b"q").await.unwrap();
    terminal.until(&["\x1b[?1049l"]).await;
    assert_eq!(terminal.urg.wait().await.unwrap().code(), Some(0));
}

#[tokio::test]
async fn a_missing_sensor_shares_the_screen() {
    let nobody = Scratch::new("not-on-screen");
    let missing = format!("rear={}@-0.2,0,180", nobody.path());
    let mut terminal = Terminal::start(&format!("view front=emulated@0.2,0,0 {missing}")).await;
    terminal.until_each(&["front", "connected", "rear", "closed", "--wait"]).await;
    terminal.user.write_all(b"\t").await.unwrap();
    terminal.until(&["of", "rear:"]).await;
    terminal.user.write_all(b"q").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));

    // With --wait it comes when it comes.
    let arguments = format!("view front=emulated@0.2,0,0 {missing} --wait");
    let mut terminal = Terminal::start(&arguments).await;
    terminal.until_each(&["front", "rear", "looking for it", "connected"]).await;
    let _sensor = Emulated::start(&format!("--link {}", nobody.path()));
    terminal.user.write_all(b"\t").await.unwrap();
    terminal.until(&["rear", "URG-04LX"]).await;
    terminal.user.write_all(b"q").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
}

#[tokio::test]
async fn ctrl_c_and_signals_restore_the_terminal() {
    let mut terminal = Terminal::start("view emulated --rate max").await;
    terminal.until(&["URG-04LX"]).await;
    // In raw mode Ctrl-C is an ordinary key.
    terminal.user.write_all(b"\x03").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));

    for signal in ["TERM", "QUIT", "USR1", "USR2", "ALRM"] {
        let mut terminal = Terminal::start("view emulated --baud 19200").await;
        terminal.until(&["URG-04LX"]).await;
        send(terminal.urg.id().unwrap(), signal);
        assert_eq!(terminal.end().await, Some(0), "{signal}");
    }
}

#[tokio::test]
async fn pasted_text_is_no_keys() {
    let mut terminal = Terminal::start("view emulated").await;
    terminal.until_each(&["URG-04LX", "quit"]).await;
    let pasted = ["\x1b[200~", &"q?".repeat(1500), "\x1b[201~"].concat();
    terminal.user.write_all(pasted.as_bytes()).await.unwrap();
    terminal.user.write_all(b"?").await.unwrap();
    // An even number of `?` would have closed the help again, and `q` the program.
    terminal.until(&["detection"]).await;
    terminal.user.write_all(b"\x03").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
}

/// As a terminal sends pasted text that does not mark it.
#[tokio::test]
async fn many_keys_do_not_delay_ctrl_c() {
    let mut terminal = Terminal::start("view emulated").await;
    terminal.until_each(&["URG-04LX", "quit"]).await;
    let began = std::time::Instant::now();
    terminal.user.write_all("wct+-".repeat(600).as_bytes()).await.unwrap();
    terminal.user.write_all(b"\x03").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
    // A frame for each key would take more than two minutes.
    assert!(began.elapsed().as_secs() < 30, "{:?}", began.elapsed());
}

#[tokio::test]
async fn a_recording_shows_and_removes_its_progress() {
    let file = Scratch::mcap("progress");
    let arguments = format!("record emulated {}", file.path());
    let mut terminal = Terminal::start_with(&arguments, |path| open(path).into()).await;
    // On a busy machine, it takes longer and may skip polls.
    let line = [" scans in 0:", " kB, ", " (Ctrl-C ends it)\x1b[K\r"];
    terminal.until(&[line, line].concat()).await;
    send(terminal.urg.id().unwrap(), "INT");
    let end = ["(Ctrl-C ends it)", "\r\x1b[Kurg: ", ".mcap: ", " scans in 0:", " kB, ", "\n"];
    terminal.until(&end).await;
    assert_eq!(terminal.urg.wait().await.unwrap().code(), Some(0));
}

/// Stops a terminal, as Ctrl-S does: writes to it block.
fn stop(terminal: &str) {
    let (stop, terminal) = (rustix::termios::Action::OOff, open(terminal));
    rustix::termios::tcflow(&terminal, stop).unwrap();
}

#[tokio::test]
async fn a_stopped_terminal_delays_neither_a_recording_nor_its_end() {
    let pipe = Scratch::pipe("stopped");
    let arguments = format!("record emulated {} --force", pipe.path());
    let mut terminal = Terminal::start_with(&arguments, |path| open(path).into()).await;
    let mut file = tokio::fs::File::open(pipe.path()).await.unwrap();
    terminal.until(&["(Ctrl-C ends it)"]).await;
    stop(&terminal.line.name().unwrap());
    // Takes longer to arrive than several progress lines are shown.
    let mut bytes = vec![0; 50_000];
    file.read_exact(&mut bytes).await.unwrap();
    send(terminal.urg.id().unwrap(), "INT");
    let ended = async {
        file.read_to_end(&mut bytes).await.unwrap();
        terminal.urg.wait().await.unwrap().code()
    };
    let ended = tokio::time::timeout(STEP_LIMIT, ended).await;
    assert_eq!(ended.expect("the program waits for the terminal"), Some(0));
    let mut recording = urg_recording::Recording::read(std::io::Cursor::new(bytes)).unwrap();
    assert!(recording.by_ref().all(|record| record.is_ok()));
    assert!(!recording.is_truncated());
}

#[tokio::test]
async fn a_stopped_terminal_delays_no_notice() {
    let link = Scratch::new("stopped");
    let (_user, line) = SerialStream::pair().unwrap();
    let path = line.name().unwrap();
    stop(&path);
    let mut emulate = Command::from(program(&format!("emulate --link {}", link.path())))
        .stderr(open(&path))
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    // The line on standard error comes before the sensor is ready.
    let info =
        Command::from(program(&format!("info {} --wait", link.path()))).kill_on_drop(true).output();
    let info =
        tokio::time::timeout(STEP_LIMIT, info).await.expect("the sensor is not there").unwrap();
    assert!(info.status.success(), "{info:?}");
    send(emulate.id().unwrap(), "INT");
    let ended =
        tokio::time::timeout(STEP_LIMIT, emulate.wait()).await.expect("the emulator does not end");
    assert_eq!(ended.unwrap().code(), Some(0));
}

#[tokio::test]
async fn a_recordings_radar_stays_and_obeys_keys() {
    let file = Scratch::mcap("radar");
    run(&format!("record emulated {} --count 5", file.path()), 0);
    let mut terminal = Terminal::start(&format!("view {}", file.path())).await;
    terminal.until_each(&["URG-04LX", "playing", "END", "at the end"]).await;
    terminal.user.write_all(b",").await.unwrap();
    terminal.until(&["PAUSED", "paused"]).await;
    terminal.user.write_all(b" ").await.unwrap();
    terminal.until(&["playing"]).await;
    terminal.user.write_all(b"q").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
}

#[tokio::test]
async fn the_radar_shows_a_recording_without_replies() {
    let file = Scratch::mcap("radar-messages");
    let path = file.path().to_owned();
    let recorded = std::thread::spawn(move || {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().start_paused(true).build().unwrap();
        runtime.block_on(super::recorded::messages_alone(&path, 5));
    });
    recorded.join().unwrap();
    let mut terminal = Terminal::start(&format!("view {}", file.path())).await;
    terminal.until_each(&["nearest", "END", "at the end"]).await;
    terminal.user.write_all(b"q").await.unwrap();
    assert_eq!(terminal.end().await, Some(0));
}

/// Makes a recording of a minute, more than a playback keeps, on a paused clock. A terminal
/// needs a clock that runs.
fn long_recording(path: &str) {
    let path = path.to_owned();
    let record = move || {
        let mut paused = tokio::runtime::Builder::new_current_thread();
        let paused = paused.enable_all().start_paused(true).build().unwrap();
        let window = tokio_scip::Window::DETECTION;
        paused.block_on(super::recorded::recording(&path, window, 600));
    };
    // A runtime cannot block inside another one.
    std::thread::spawn(record).join().unwrap();
}

#[tokio::test]
async fn a_radar_ends_when_its_file_is_overwritten() {
    let file = Scratch::mcap("overwritten");
    long_recording(file.path());
    let arguments = format!("view {} --loop --speed 100", file.path());
    let mut terminal = Terminal::start_with(&arguments, |path| open(path).into()).await;
    terminal.until_each(&["URG-04LX", "playing"]).await;
    let bytes = std::fs::read(file.path()).unwrap();
    std::fs::write(file.path(), &bytes[..2000]).unwrap();
    terminal.until(&["\x1b[?1049l", "urg: ", "\n"]).await;
    // The loop may begin anew at this moment, and opens what is left.
    let reasons = ["the file was changed", "no scan in this recording"];
    assert!(reasons.iter().any(|reason| terminal.drawn.contains(reason)), "{}", terminal.drawn);
    assert_eq!(terminal.end().await, Some(1));
}

#[tokio::test]
async fn a_terminal_gets_short_lines() {
    let mut terminal = Terminal::start("stream emulated --count 3").await;
    terminal.until(&["    0 ", "/682 points", " nearest ", "    1 ", "    2 ", "\n"]).await;
    assert_eq!(terminal.urg.wait().await.unwrap().code(), Some(0));
    let lines: Vec<_> = terminal.drawn.lines().map(str::trim_end).collect();
    assert_eq!(lines.len(), 3, "{lines:?}");
    assert!(lines.iter().all(|line| line.chars().count() <= 80), "{lines:?}");

    // `--format` applies on a terminal, too.
    let mut terminal = Terminal::start("stream emulated --count 1 --format ndjson").await;
    terminal.until(&["{\"sequence\":0", "\"ranges\":[", "}"]).await;
}

#[test]
fn a_recording_is_not_shown_beside_another_source() {
    let file = Scratch::mcap("alone");
    run(&format!("record emulated {} --count 2", file.path()), 0);
    let text = run(&format!("view a={} b=emulated", file.path()), 2).stderr;
    assert!(text.contains("plays one recording") && text.contains("urg serve"), "{text}");
}

#[tokio::test]
async fn a_recording_stays_off_the_terminal() {
    for (arguments, text) in [
        ("record emulated -", "a recording is no text for a terminal"),
        ("stream -", "standard input, and that is a terminal"),
    ] {
        let mut terminal = Terminal::start_with(arguments, |path| open(path).into()).await;
        terminal.until(&[text]).await;
        assert_eq!(terminal.urg.wait().await.unwrap().code(), Some(2), "{arguments}");
    }
}
