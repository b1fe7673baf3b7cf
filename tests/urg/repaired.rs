//! `urg repair`, `--split`, and recordings that end because of a write error.

use std::fs;
use std::io::Cursor;
use std::process::Command;

use serde_json::Value;
use tokio_scip::Window;
use tokio_scip::recording::{Entry, Recording};

use super::formats::scans;
use super::program::{Scratch, failure, run};
use super::recorded::recording;

fn scratch(name: &str) -> Scratch {
    Scratch::with_extension(name, ".mcap")
}

fn count(path: &str) -> usize {
    let records = Recording::open(path).unwrap().map(|record| record.unwrap().entry);
    records.filter(|entry| matches!(entry, Entry::Scan(_))).count()
}

#[tokio::test(start_paused = true)]
async fn a_cut_off_recording_has_the_same_scans_in_info_and_replay_and_is_repaired() {
    let (whole, cut) = (scratch("repair-whole"), scratch("repair-cut"));
    recording(whole.path(), Window::DETECTION, 400).await;
    let bytes = fs::read(whole.path()).unwrap();
    fs::write(cut.path(), &bytes[..bytes.len() * 3 / 4]).unwrap();
    let info = |path: &str| -> Value {
        serde_json::from_str(&run(&format!("info {path} --format json"), 0).stdout).unwrap()
    };
    let text = run(&format!("info {}", cut.path()), 0).stdout;
    assert!(text.contains(&format!("`urg repair {}`", cut.path())), "{text}");
    let before = info(cut.path());
    assert_eq!(before["complete"], false);
    let replayed = run(&format!("stream {} --rate max --format ndjson", cut.path()), 0);
    assert_eq!(before["scans"], scans(&replayed.stdout).len());

    // The copy has its own name beside the file.
    let out = cut.path().replace(".mcap", ".repaired.mcap");
    let stderr = run(&format!("repair {}", cut.path()), 0).stderr;
    assert!(stderr.contains("complete") && stderr.contains("its end was missing"), "{stderr}");
    let after = info(&out);
    assert_eq!((&after["complete"], &after["scans"]), (&true.into(), &before["scans"]));
    // Nothing is overwritten, and a whole file is not copied.
    let stderr = failure(&format!("repair {}", cut.path()));
    assert!(stderr.contains(&out), "{stderr}");
    fs::remove_file(&out).unwrap();
    let stderr = run(&format!("repair {} {out}", whole.path()), 0).stderr;
    assert!(stderr.contains("nothing to repair"), "{stderr}");
    assert!(!fs::exists(&out).unwrap());
}

#[test]
fn a_split_recording_has_its_scans_in_several_files() {
    let file = scratch("split-run");
    let record = format!("record emulated {} --count 90 --rate max --split 150kB", file.path());
    let stderr = run(&record, 0).stderr;
    assert!(
        stderr.contains("90 scans in ") && stderr.contains(" kB in 3 files, none lost"),
        "{stderr}"
    );
    let parts: Vec<String> =
        (2..=3).map(|n| file.path().replace(".mcap", &format!("_{n:04}.mcap"))).collect();
    let counts: Vec<usize> =
        [file.path()].into_iter().chain(parts.iter().map(String::as_str)).map(count).collect();
    assert_eq!(counts.iter().sum::<usize>(), 90, "{counts:?}");
    parts.iter().for_each(|part| fs::remove_file(part).unwrap());
}

/// The signal for exceeding a limit on file size ends a program without a message unless
/// it is handled.
#[test]
fn a_limit_on_the_size_of_files_is_reported_as_a_failure_to_write() {
    let (file, lines) = (scratch("limited"), Scratch::new("limited-lines"));
    let urg = env!("CARGO_BIN_EXE_urg");
    for command in [
        format!("exec {urg} record emulated {} --rate max --duration 60s", file.path()),
        format!("exec {urg} stream emulated --rate max --duration 60s > {}", lines.path()),
    ] {
        // In blocks of 512 or 1024 bytes.
        let script = format!("ulimit -f 64; {command}");
        let output = Command::new("sh").args(["-c", &script]).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{command}: {stderr}");
        assert!(stderr.to_lowercase().contains("file too large"), "{command}: {stderr}");
    }
    let file = fs::read(file.path()).unwrap();
    let mut recording = Recording::read(Cursor::new(file)).unwrap();
    assert!(recording.by_ref().filter(Result::is_ok).count() > 5);
    assert!(recording.is_truncated());
}
