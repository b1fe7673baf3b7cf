//! `urg repair`, `--split`, and recordings that end because of a write error.

use std::fs;
use std::process::Command;

use serde_json::Value;
use tokio_scip::Window;
use urg_recording::{Entry, Recording};

use super::formats::scans;
use super::program::{Emulated, Scratch, failure, output_of, program, run};
use super::recorded::recording;

fn count(path: &str) -> usize {
    let records = Recording::open(path).unwrap().map(|record| record.unwrap().entry);
    records.filter(|entry| matches!(entry, Entry::Scan(_))).count()
}

#[tokio::test(start_paused = true)]
async fn a_truncated_recording_is_read_and_repaired() {
    let (whole, cut) = (Scratch::mcap("repair-whole"), Scratch::mcap("repair-cut"));
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
    // Nor is a file without a message, such as an empty one.
    for length in [0, 100] {
        fs::write(cut.path(), &bytes[..length]).unwrap();
        let stderr = failure(&format!("repair {}", cut.path()));
        assert!(stderr.contains("no message in it can be read"), "{stderr}");
        assert!(!fs::exists(&out).unwrap());
    }
}

#[tokio::test(start_paused = true)]
async fn concatenated_recordings_are_read_and_repaired() {
    let (one, both) = (Scratch::mcap("repair-one"), Scratch::mcap("repair-both"));
    recording(one.path(), Window::DETECTION, 20).await;
    let bytes = fs::read(one.path()).unwrap();
    fs::write(both.path(), [&bytes[..], &bytes].concat()).unwrap();
    assert_eq!(count(both.path()), 40);
    let info = run(&format!("info {}", both.path()), 0).stdout;
    assert!(info.contains("40") && info.contains("`urg repair"), "{info}");
    let stderr = run(&format!("repair {}", both.path()), 0).stderr;
    assert!(stderr.contains(": 40 scans, complete ("), "{stderr}");
    assert_eq!(count(&both.path().replace(".mcap", ".repaired.mcap")), 40);
    // An existing file is not replaced, and nothing recommends to.
    let (one, both) = (one.path(), both.path());
    let stderr = failure(&format!("cut {one} {both}"));
    assert!(stderr.contains(&format!("{both} exists: use another name")), "{stderr}");
    let stderr = run(&format!("record {one} {one} --force"), 2).stderr;
    assert!(stderr.contains(&format!("`urg cut {one} copy.mcap`")), "{stderr}");
}

#[cfg(unix)]
#[tokio::test(start_paused = true)]
async fn a_file_name_cannot_control_the_terminal() {
    let file = Scratch::mcap("\x1b[2J");
    recording(file.path(), Window::DETECTION, 20).await;
    let whole = fs::read(file.path()).unwrap();
    fs::write(file.path(), &whole[..whole.len() - 100]).unwrap();
    let info = run(&format!("info {}", file.path()), 0);
    let scans = run(&format!("stream {} --format csv", file.path()), 0);
    let repaired = run(&format!("repair {}", file.path()), 0);
    // clap writes colours, as to a terminal.
    let mut refused = program("view \x1b[2J --rate 0");
    refused.env("CLICOLOR_FORCE", "1");
    let refused = output_of(refused);
    assert_eq!(refused.code, Some(2));
    assert!(refused.stderr.contains("control characters"), "{:?}", refused.stderr);
    for text in [info.stdout, info.stderr, scans.stderr, repaired.stderr, refused.stderr] {
        assert!(!text.contains('\x1b'), "{text:?}");
    }
    fs::remove_file(file.path().replace(".mcap", ".repaired.mcap")).unwrap();
}

/// Other readers open a file by its index.
#[tokio::test(start_paused = true)]
async fn a_damaged_index_is_told_by_info_and_repaired() {
    let file = Scratch::mcap("index");
    recording(file.path(), Window::DETECTION, 20).await;
    let mut bytes = fs::read(file.path()).unwrap();
    let at = bytes.len() - 100;
    bytes[at] ^= 1;
    fs::write(file.path(), bytes).unwrap();
    let text = run(&format!("info {}", file.path()), 0).stdout;
    assert!(text.contains("complete       no: its end is missing or damaged"), "{text}");
    let out = file.path().replace(".mcap", ".repaired.mcap");
    run(&format!("repair {}", file.path()), 0);
    assert!(run(&format!("info {out}"), 0).stdout.contains("complete       yes"));
    fs::remove_file(&out).unwrap();
}

#[test]
fn a_split_recording_has_its_scans_in_several_files() {
    let file = Scratch::mcap("split-run");
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

#[test]
fn a_bounded_recording_removes_old_files() {
    let folder = Scratch::new("keep-run");
    fs::create_dir(folder.path()).unwrap();
    let file = format!("{}/run.mcap", folder.path());
    let link = Scratch::new("keep-link");
    let sensor = Emulated::start(&format!("--revolution 10ms --link {}", link.path()));
    let record = format!("record {} {file} --count 300 --rate max", sensor.port);
    let stderr = run(&format!("{record} --split 100kB --keep 300kB"), 0).stderr;
    assert!(stderr.contains("300 scans in ") && stderr.contains(", none lost"), "{stderr}");
    let files: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().collect();
    let bytes: u64 = files.iter().map(|file| file.metadata().unwrap().len()).sum();
    // The last file may have grown by a chunk since old ones were removed.
    assert!(!fs::exists(&file).unwrap() && bytes < 450_000, "{bytes} bytes in {files:?}");
    fs::remove_dir_all(folder.path()).unwrap();
}

/// The signal for exceeding a limit on file size ends a program without a message unless
/// it is handled.
#[test]
fn a_file_that_holds_no_second_is_a_write_failure() {
    let (file, lines) = (Scratch::mcap("limited"), Scratch::new("limited-lines"));
    let urg = env!("CARGO_BIN_EXE_urg");
    for command in [
        format!("exec {urg} record emulated {} --rate max --duration 60s", file.path()),
        format!("exec {urg} stream emulated --rate max --duration 60s > {}", lines.path()),
    ] {
        // The shell counts blocks of 512 or 1024 bytes.
        let script = format!("ulimit -f 64; {command}");
        let output = Command::new("sh").args(["-c", &script]).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{command}: {stderr}");
        assert!(stderr.to_lowercase().contains("file too large"), "{command}: {stderr}");
    }
}

/// The scans are in one file or in several, joined in any order.
#[test]
fn every_command_counts_the_same_scans() {
    let folder = Scratch::new("counts");
    fs::create_dir(folder.path()).unwrap();
    let path = |name: &str| format!("{}/{name}.mcap", folder.path());
    let record = format!("record emulated {} --rate max --duration 1500ms", path("run"));
    let stderr = run(&format!("{record} --split 20kB"), 0).stderr;
    let told = stderr.split(": ").last().unwrap();
    let (scans, rest) = told.split_once(" scans in ").unwrap();
    let (length, _) = rest.split_once(',').unwrap();

    let (first, others) = (path("run"), path("run_*"));
    let joined = path("joined");
    let script = format!("{} cut {others} {first} {joined}", env!("CARGO_BIN_EXE_urg"));
    let output = Command::new("sh").args(["-c", &script]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.ends_with(&format!(": {scans} scans\n")), "{stderr}");
    let info = run(&format!("info {joined}"), 0).stdout;
    assert!(info.contains(&format!("scans          {scans} of ")), "{scans}: {info}");
    assert!(info.contains(&format!(" UTC, for {length}\n")), "{length}: {info}");

    let bytes = fs::read(&joined).unwrap();
    fs::write(&joined, &bytes[..bytes.len() - 10]).unwrap();
    let stderr = run(&format!("repair {joined}"), 0).stderr;
    assert!(stderr.contains(&format!(": {scans} scans, complete")), "{stderr}");
    fs::remove_dir_all(folder.path()).unwrap();
}

/// A scan that comes just after `--duration` counts: its reply is in the file.
#[test]
fn a_recording_counts_its_last_scan_whenever_it_ends() {
    let end_at_odd_times = |sensor: u64| {
        let file = Scratch::mcap(&format!("last-{sensor}"));
        let link = Scratch::new(&format!("last-link-{sensor}"));
        let sensor = Emulated::start(&format!("--revolution 10ms --link {}", link.path()));
        let mut most = 0;
        for milliseconds in 101..=115 {
            let record = format!("record {} {} --force --rate max", sensor.port, file.path());
            let record = output_of(program(&format!("{record} --duration {milliseconds}ms")));
            let info = run(&format!("info {} --format json", file.path()), 0).stdout;
            let info: Value = serde_json::from_str(&info).unwrap();
            let scans = info["scans"].as_u64().unwrap();
            let told = format!(": {scans} scan{} in ", if scans == 1 { "" } else { "s" });
            assert!(
                record.stderr.contains(&told),
                "{told}after {milliseconds} ms: {}",
                record.stderr
            );
            // On a busy machine none may come in time, which is a failure.
            assert_eq!(record.code, Some(i32::from(scans == 0)), "{}", record.stderr);
            most = most.max(scans);
        }
        assert!(most > 0);
    };
    std::thread::scope(|scope| {
        for sensor in 0..8 {
            scope.spawn(move || end_at_odd_times(sensor));
        }
    });
}
