//! Recordings to standard output and from standard input, through real pipes.

use std::fs;

use serde_json::Value;
use tokio_scip::Window;
use urg_recording::Recording;

use super::formats::{check, scans, values};
use super::program::{Running, Scratch, run, shell};
use super::recorded::recording;

/// Runs a script to its end, and returns standard output and standard error.
fn script(script: &str, exit_code: i32) -> (String, String) {
    let output = shell(script).output().unwrap();
    let (stdout, stderr) = (String::from_utf8(output.stdout), String::from_utf8(output.stderr));
    let (stdout, stderr) = (stdout.unwrap(), stderr.unwrap());
    assert_eq!(output.status.code(), Some(exit_code), "{stderr}");
    (stdout, stderr)
}

#[test]
fn a_recording_goes_through_a_pipe_into_another_program() {
    let (stdout, stderr) = script("$urg record emulated - --count 5 | $urg stream -", 0);
    let scans = scans(&stdout);
    assert_eq!(scans.len(), 5, "{stderr}");
    scans.iter().for_each(check);
    assert!(stderr.contains("urg: standard output: 5 scans in "), "{stderr}");
    assert!(stderr.contains("urg: standard input: the recording has ended"), "{stderr}");
}

/// The recorder is not asked to end, so its scans come while it records.
#[test]
fn a_recorded_stream_ends_with_its_reader() {
    let mut live = Running::spawn(shell("$urg record emulated - | exec $urg stream -"));
    live.read();
    for number in 0..15 {
        let scan: Value = serde_json::from_str(&live.line()).unwrap();
        assert_eq!(scan["sequence"], number);
    }
    live.close_pipe();
    let (status, notices) = live.end();
    assert_eq!(status.code(), Some(0), "the reader of the pipe: {notices:?}");
    let closed = "urg: standard output: its reader has closed it, and the recording has ended";
    assert!(notices.iter().any(|notice| notice == closed), "{notices:?}");
}

#[test]
fn an_interrupted_recording_to_standard_output_is_complete() {
    let file = Scratch::mcap("stdout");
    let record = Running::spawn(shell(&format!("exec $urg record emulated - > {}", file.path())));
    while fs::metadata(file.path()).map_or(0, |file| file.len()) < 10_000 {
        std::thread::yield_now();
    }
    record.signal("INT");
    let (status, notices) = record.end();
    assert_eq!(status.code(), Some(0), "{notices:?}");
    let mut recording = Recording::open(file.path()).unwrap();
    assert!(recording.by_ref().all(|record| record.is_ok()) && !recording.is_truncated());
}

#[tokio::test(start_paused = true)]
async fn every_command_reads_a_recording_from_standard_input() {
    let (file, out) = (Scratch::mcap("stdin"), Scratch::mcap("from-stdin"));
    let recorded = recording(file.path(), Window::DETECTION, 20).await;
    let (path, out) = (file.path(), out.path());
    let (info, _) = script(&format!("cat {path} | $urg info -"), 0);
    assert!(info.starts_with("port           standard input\n"), "{info}");
    assert!(info.contains("serial number  H0713090\n") && info.contains("scans          20 of"));
    let (checked, _) = script(&format!("cat {path} | $urg check -"), 0);
    assert!(checked.contains("scans    20 of steps 44..=725"), "{checked}");
    for pace in ["", "--rate max"] {
        let (lines, _) = script(&format!("cat {path} | $urg stream - {pace}"), 0);
        assert_eq!(scans(&lines).iter().map(values).collect::<Vec<_>>(), recorded);
    }
    let (_, notices) = script(&format!("cat {path} | $urg cut - {out} --range 1s.."), 0);
    assert!(notices.contains(" scans"), "{notices}");
    fs::remove_file(out).unwrap();
    let (_, notices) = script(&format!("head -c 30000 {path} | $urg repair - {out}"), 0);
    assert!(notices.contains("complete"), "{notices}");
    assert!(run(&format!("info {out}"), 0).stdout.contains("complete       yes"));

    let (_, stderr) = script(&format!("cat {path} | $urg repair -"), 2);
    assert!(stderr.contains("urg repair - whole.mcap"), "{stderr}");
    for command in ["view", "serve"] {
        let (_, stderr) = script(&format!("cat {path} | $urg {command} -"), 2);
        assert!(stderr.contains("urg stream -"), "{stderr}");
    }
    let (_, stderr) = script("$urg stream - < /dev/null", 1);
    assert!(stderr.contains("no scan in this recording"), "{stderr}");
}

#[test]
fn a_pipe_that_brings_nothing_can_be_interrupted() {
    for command in ["stream", "info", "check"] {
        // Its standard input stays open.
        let mut waiting = Running::spawn(shell(&format!("echo; exec $urg {command} -")));
        waiting.read();
        waiting.line();
        // Before the program listens for it, a signal ends it as well; but not `INT` in a shell's
        // background.
        waiting.signal("TERM");
        waiting.end();
    }
}

#[cfg(unix)]
#[test]
fn a_closed_standard_output_gets_no_recording() {
    let (_, stderr) = script("$urg record emulated - --count 1 >&-", 2);
    assert!(stderr.contains("standard output is closed"), "{stderr}");
    script("$urg record emulated - --count 1 > /dev/null", 0);
}

#[test]
fn options_of_files_are_refused_for_standard_output() {
    for options in ["--split 1h", "--split 1h --keep 1GB"] {
        let stderr = run(&format!("record emulated - {options}"), 2).stderr;
        assert!(stderr.contains("standard output is one recording"), "{stderr}");
    }
}
