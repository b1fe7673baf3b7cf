//! Recording with the program, and recordings in place of a port.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::process::{Command, Stdio};
use std::time::Instant;

use serde_json::Value;
use tokio::net::TcpListener;
use tokio_scip::{Rate, ScanStream, Sensor, Window};
use urg_emulator::{Emulator, Values, WorldTime};
use urg_recording::Event;
use urg_recording::{Entry, Recorder, Recording};

use super::formats::{check, scans, values};
use super::program::{
    Emulated, Running, STEP_LIMIT, Scratch, failure, output_of, program, run, send, shell,
};
use super::served::{FAST, SCANS, check_held, held};

/// Makes a recording of scans at 10 Hz on the paused clock, and returns their values.
pub(super) async fn recording(path: &str, window: Window, count: usize) -> Vec<Vec<u64>> {
    recording_of(Emulator::builder().usb().build(), path, window, Rate::hz(10.0), count).await
}

/// Makes a recording of an emulated sensor on the paused clock, and returns its scans' values.
pub(super) async fn recording_of(
    emulator: Emulator,
    path: &str,
    window: Window,
    rate: Rate,
    count: usize,
) -> Vec<Vec<u64>> {
    let recorder = Recorder::create(path).unwrap();
    let builder = Sensor::builder().on_reply(recorder.observer()).depth(1024);
    let sensor = builder.connect(emulator).await.unwrap();
    let scans = sensor.scans(window, rate).await.unwrap();
    recorder.describe(&sensor, &scans).await.unwrap();
    recorded(recorder, scans, count).await
}

/// Makes a recording of `/scan` messages alone, as another program would, and returns its scans'
/// values.
pub(super) async fn messages_alone(path: &str, count: usize) -> Vec<Vec<u64>> {
    let recorder = Recorder::create(path).unwrap();
    let sensor = Sensor::builder().connect(Emulator::builder().usb().build()).await.unwrap();
    let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    recorded(recorder, scans, count).await
}

/// Records scans, and returns their values.
async fn recorded(mut recorder: Recorder, mut scans: ScanStream, count: usize) -> Vec<Vec<u64>> {
    let mut all = Vec::new();
    while all.len() < count {
        let item = scans.next().await.unwrap();
        recorder.record(&item).unwrap();
        all.extend(item.iter().map(|scan| scan.raw_values().map(u64::from).collect()));
    }
    assert_eq!(recorder.progress().lost, 0);
    recorder.finish().await.unwrap();
    all
}

/// Returns the ranges of the scans in a file, and the bytes of the replies to polls.
fn contents(recording: Recording) -> (Vec<Vec<f32>>, Vec<Vec<u8>>) {
    let (mut scans, mut polls) = (Vec::new(), Vec::new());
    for record in recording {
        match record.unwrap().entry {
            Entry::Scan(scan) => scans.push(scan.ranges),
            Entry::Reply(reply) if reply.command.is_some() && reply.bytes[0] == b'G' => {
                polls.push(reply.bytes);
            }
            _ => {}
        }
    }
    (scans, polls)
}

/// Returns the ranges in a line of NDJSON as a recording has them, finite ones only.
fn ranges(scan: &Value) -> Vec<Option<f32>> {
    let ranges = scan["ranges"].as_array().unwrap().iter();
    ranges.map(|range| range.as_f64().map(|range| range as f32)).collect()
}

#[test]
fn a_folder_is_a_recording() {
    let folder = Scratch::new("bag");
    let path = folder.path();
    fs::create_dir(path).unwrap();
    let record =
        |name: &str| run(&format!("record emulated {path}/{name} --rate max --count 3"), 0);
    record("bag_0.mcap");
    record("bag_1.mcap");
    assert!(run(&format!("info {path}"), 0).stdout.contains("scans          6 of "));
    assert_eq!(scans(&run(&format!("stream {path} --rate max"), 0).stdout).len(), 6);
    let joined = Scratch::mcap("joined");
    let notice = run(&format!("cut {path} {}", joined.path()), 0).stderr;
    assert!(notice.contains("6 scans"), "{notice}");
    let last = File::options().write(true).open(format!("{path}/bag_1.mcap")).unwrap();
    last.set_len(last.metadata().unwrap().len() - 20).unwrap();
    let told = run(&format!("info {path}"), 0).stdout;
    assert!(told.contains(&format!("urg repair {path}")), "{told}");
    fs::rename(format!("{path}/bag_0.mcap"), format!("{path}/old.bag")).unwrap();
    for command in [format!("info {path}"), format!("info {path}/old.bag")] {
        let told = run(&command, 1).stderr;
        assert!(told.contains("found a ROS 1 bag; convert it with `rosbags-convert"), "{told}");
    }
    fs::remove_dir_all(path).unwrap();
}

#[test]
fn a_frame_that_tf2_refuses_is_refused() {
    let file = Scratch::mcap("frame");
    let told = run(&format!("record emulated {} --count 1 --frame-id /laser", file.path()), 2);
    assert!(told.stderr.contains("without a leading `/`"), "{}", told.stderr);
}

#[test]
fn info_counts_the_scans_of_each_window() {
    let [first, second, both] = ["first", "second", "both"].map(Scratch::mcap);
    for (path, options) in [(&first, "100..200 --count 3"), (&second, "300..500 --count 2")] {
        run(&format!("record emulated {} --rate max --window {options}", path.path()), 0);
    }
    run(&format!("cut {} {} {}", first.path(), second.path(), both.path()), 0);
    let info = run(&format!("info {}", both.path()), 0).stdout;
    assert!(
        info.contains(
            "scans          5: 3 of steps 100..=200, 2 of steps 300..=500, asked for at max"
        ),
        "{info}"
    );
}

#[tokio::test]
async fn recording_and_replay_have_the_sensors_scans() {
    let (file, link) = (Scratch::mcap("held"), Scratch::new("recorded"));
    let sensor = Emulated::start(&format!("--link {} --seed 7 {FAST}", link.path()));
    let output =
        run(&format!("record {} {} --rate max --count {SCANS}", sensor.port, file.path()), 0);
    assert_eq!(output.stdout, "");
    assert!(output.stderr.contains(&format!("{SCANS} scans in 0:0")), "{}", output.stderr);
    assert!(output.stderr.ends_with(", none lost\n"), "{}", output.stderr);

    let replay = run(&format!("stream {} --rate max --count {SCANS}", file.path()), 0);
    check_held(&replay.stdout, &held(7, sensor.began).await);
    let (recorded, _) = contents(Recording::open(file.path()).unwrap());
    assert_eq!(recorded.len(), SCANS);
    // A replay at another rate keeps the recorded stamps.
    let stamps: Vec<_> =
        scans(&replay.stdout).iter().map(|scan| scan["stamp"].as_f64().unwrap()).collect();
    assert!(stamps[SCANS - 1] - stamps[0] > 1.0, "{stamps:?}");
    for (scan, recorded) in scans(&replay.stdout).iter().zip(&recorded) {
        let finite = |range: &f32| Some(*range).filter(|range| range.is_finite());
        assert_eq!(ranges(scan), recorded.iter().map(finite).collect::<Vec<_>>());
    }
}

#[tokio::test(start_paused = true)]
async fn a_replay_has_the_recorded_window_and_pace() {
    let file = Scratch::mcap("own");
    let window = Window::new(100..=200).unwrap().with_cluster_count(2).unwrap();
    let recorded = recording(file.path(), window, 10).await;
    for pace in ["", "--rate max", "--rate 50"] {
        let began = std::time::Instant::now();
        let output = run(&format!("stream {} {pace}", file.path()), 0);
        assert_eq!(
            output.stderr,
            format!("urg: {}: the recording has ended\n", file.path()),
            "{pace}"
        );
        let scans = scans(&output.stdout);
        scans.iter().for_each(check);
        assert_eq!(scans.iter().map(values).collect::<Vec<_>>(), recorded, "{pace}");
        let first = &scans[0];
        assert_eq!((&first["start"], &first["cluster"]), (&100.into(), &2.into()));
        // Nine periods, unless another rate is asked for; no scan comes before its time.
        assert!(!pace.is_empty() || began.elapsed().as_secs_f64() > 0.85);
    }
    // A smaller window, and only a part of the recording.
    let output = run(&format!("stream {} --window 150..200 --count 3 --rate max", file.path()), 0);
    assert_eq!(output.stderr, "");
    let part: Vec<_> = scans(&output.stdout).iter().map(values).collect();
    assert_eq!(part, recorded[..3].iter().map(|all| all[25..].to_vec()).collect::<Vec<_>>());
}

#[tokio::test(start_paused = true)]
async fn every_command_that_reads_a_sensor_reads_a_recording() {
    let file = Scratch::mcap("every");
    let recorded = recording(file.path(), Window::DETECTION, 20).await;
    let path = file.path();
    let info = run(&format!("info {path}"), 0).stdout;
    assert!(info.contains("SOKUIKI Sensor URG-04LX") && info.contains(path), "{info}");
    assert!(info.contains("scans          20 of steps 44..=725, asked for at 10 Hz"), "{info}");
    assert!(info.contains("gaps           none\n"), "{info}");
    let info = run(&format!("info {path} --format json"), 0).stdout;
    let info: Value = serde_json::from_str(&info).unwrap();
    assert_eq!((&info["scans"], &info["complete"]), (&20.into(), &true.into()));
    let scan = run(&format!("scan {path} --format json"), 0).stdout;
    assert_eq!(values(&serde_json::from_str(&scan).unwrap()), recorded[0]);
    assert!(run(&format!("scan {path} --format svg"), 0).stdout.ends_with("</svg>\n"));
    let check = run(&format!("check {path}"), 0);
    assert!(check.stdout.contains("ok      gaps     none\n"), "{}", check.stdout);
    assert!(!check.stdout.contains("laser"), "{}", check.stdout);
    assert!(check.stdout.ends_with("\nall is well\n"), "{}", check.stdout);
    let bytes = std::fs::read(path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() - 100]).unwrap();
    let check = run(&format!("check {path}"), 1);
    assert!(check.stdout.contains("FAILED  complete no: its end is missing"), "{}", check.stdout);
}

#[test]
fn a_recording_is_compressed_and_copied() {
    let names = ["compressed", "compressed-kept", "compressed-plain"];
    let [file, kept, plain] = names.map(Scratch::mcap);
    run(&format!("record emulated {} --count 20 --compress lz4", file.path()), 0);
    run(&format!("cut {} {}", file.path(), kept.path()), 0);
    run(&format!("cut {} {} --compress none", file.path(), plain.path()), 0);
    let info = |path: &str| -> Value {
        serde_json::from_str(&run(&format!("info {path} --format json"), 0).stdout).unwrap()
    };
    let stream = |path: &str| run(&format!("stream {path} --rate max --format ndjson"), 0).stdout;
    for (path, names) in
        [(file.path(), vec!["lz4"]), (kept.path(), vec!["lz4"]), (plain.path(), vec![])]
    {
        let found = &info(path)["compression"];
        let [bytes, plain] = ["bytes", "plain_bytes"].map(|key| found[key].as_u64().unwrap());
        assert_eq!((&found["names"], bytes < plain), (&names.clone().into(), !names.is_empty()));
        assert_eq!(stream(path), stream(file.path()));
    }
    let text = run(&format!("info {}", file.path()), 0).stdout;
    assert!(text.contains("compression    lz4, to "), "{text}");
    let text = run(&format!("info {}", plain.path()), 0).stdout;
    assert!(text.contains("compression    none\n"), "{text}");
}

#[tokio::test(start_paused = true)]
async fn a_recording_without_replies_is_read_by_every_command() {
    let (file, copy) = (Scratch::mcap("messages"), Scratch::mcap("messages-copy"));
    let recorded = messages_alone(file.path(), 20).await;
    // Messages have no error codes.
    let distances = |values: &[u64]| -> Vec<Option<u64>> {
        values.iter().map(|&value| (20..4095).contains(&value).then_some(value)).collect()
    };
    let recorded: Vec<_> = recorded.iter().map(|scan| distances(scan)).collect();
    let info = run(&format!("info {}", file.path()), 0).stdout;
    assert!(info.contains("scans          20 of steps 44..=725\n"), "{info}");
    assert!(!info.contains("serial number"), "{info}");
    let first = run(&format!("scan {} --format json", file.path()), 0).stdout;
    assert_eq!(distances(&values(&serde_json::from_str(&first).unwrap())), recorded[0]);
    run(&format!("cut {} {}", file.path(), copy.path()), 0);
    for path in [file.path(), copy.path()] {
        let streamed = run(&format!("stream {path} --rate max"), 0).stdout;
        let streamed = scans(&streamed);
        let streamed: Vec<_> = streamed.iter().map(|scan| distances(&values(scan))).collect();
        assert_eq!(streamed, recorded);
    }
}

#[tokio::test(start_paused = true)]
async fn a_part_of_a_recording_can_be_streamed_and_cut_out() {
    let (file, part) = (Scratch::mcap("whole"), Scratch::mcap("part"));
    let recorded = recording(file.path(), Window::DETECTION, 50).await;
    let output = run(&format!("stream {} --range 1s..0:03 --rate max", file.path()), 0);
    let streamed: Vec<_> = scans(&output.stdout).iter().map(values).collect();
    assert!((19..=21).contains(&streamed.len()), "{}", streamed.len());
    let first = recorded.iter().position(|scan| *scan == streamed[0]).unwrap();
    assert!((9..=11).contains(&first) && recorded[first..].starts_with(&streamed), "{first}");
    let cut = format!("cut {} {} --range 1s..0:03", file.path(), part.path());
    assert!(run(&cut, 0).stderr.contains(&format!("{} scans", streamed.len())));
    let output = run(&format!("stream {}", part.path()), 0);
    assert_eq!(scans(&output.stdout).iter().map(values).collect::<Vec<_>>(), streamed);
    // It has the times of the recording, for other readers, too.
    let times = |path: &str| -> Vec<_> {
        let scans = Recording::open(path).unwrap().map(Result::unwrap);
        let scans = scans.filter(|record| matches!(record.entry, Entry::Scan(_)));
        scans.map(|record| (record.sequence, record.at)).collect()
    };
    let (all, copied) = (times(file.path()), times(part.path()));
    assert!(copied.len() >= 19 && copied.iter().all(|time| all.contains(time)), "{copied:?}");
    assert!(failure(&cut).contains(part.path()), "an existing file was overwritten");
    let nothing = Scratch::mcap("nothing");
    failure(&format!("cut {} {} --range 99s..", file.path(), nothing.path()));
    assert!(!fs::exists(nothing.path()).unwrap());
    let foreign = Scratch::new("foreign.txt");
    fs::write(foreign.path(), "no recording").unwrap();
    let join = format!("cut {} {} {}", file.path(), foreign.path(), nothing.path());
    let line = failure(&join);
    assert!(line.contains(&format!("{}: not a recording", foreign.path())), "{line}");
    let line = failure(&format!("cut {} {}/absent/part.mcap", file.path(), foreign.path()));
    assert!(line.starts_with(&format!("urg: {}/absent/part.mcap: ", foreign.path())), "{line}");

    let line = run(&format!("stream {} --range 99s..", file.path()), 1).stderr;
    assert!(line.contains("no scan in --range 99s.."), "{line}");
    let line = run("stream emulated --range 1s..2s", 2).stderr;
    assert!(line.contains("emulated is a sensor"), "{line}");
    for command in ["view emulated --speed 2", "view run.mcap --rate 5 --speed 0"] {
        run(command, 2);
    }
}

/// The recording has many more scans than streams keep.
#[tokio::test(start_paused = true)]
async fn a_replay_waits_for_a_reader_that_is_slow() {
    let file = Scratch::mcap("long");
    let recorded = recording(file.path(), Window::DETECTION, 600).await;
    let mut slow = Running::start_unread(&format!("stream {} --rate max", file.path()));
    // By the end of this the pipe of the other one has long been full.
    run(&format!("stream {} --rate max", file.path()), 0);
    slow.read();
    let lines: Vec<Value> =
        slow.rest().iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 600);
    assert!(lines.iter().zip(&recorded).all(|(line, recorded)| values(line) == *recorded));
}

#[test]
fn polls_without_a_scan_are_counted_for_the_recording_alone() {
    let (file, link) = (Scratch::mcap("tally"), Scratch::new("tally"));
    let faults = "--revolution 10ms --faults damaged=0.4,seed=5";
    let sensor = Emulated::start(&format!("--link {} {faults}", link.path()));
    let record = format!("record {} {} --rate max --count 20", sensor.port, file.path());
    let stderr = run(&record, 0).stderr;
    let records = Recording::open(file.path()).unwrap().map(|record| record.unwrap().entry);
    let is_failure = |entry: &Entry| matches!(entry, Entry::Event(Event::Error { .. }));
    let failed = records.filter(is_failure).count();
    assert!(failed > 3, "{stderr}");
    assert_eq!(stderr.matches("(reported once; polling continues)").count(), 1, "{stderr}");
    let check = run(&format!("check {}", file.path()), 0).stdout;
    assert!(check.contains(&format!("weak    losses   {failed} polls without a scan")), "{check}");
    assert!(stderr.contains(&format!(", {failed} polls without a scan")), "{failed}: {stderr}");
}

#[test]
fn a_file_is_overwritten_only_with_force() {
    let (file, nobody) = (Scratch::mcap("exists"), Scratch::new("nobody"));
    let precious = b"precious".repeat(100_000);
    fs::write(file.path(), &precious).unwrap();
    let line = failure(&format!("record emulated {}", file.path()));
    assert!(line.contains("exists: use another name") && line.contains("--force"), "{line}");
    failure(&format!("record {} {} --force", nobody.path(), file.path()));
    assert!(fs::read(file.path()).unwrap() == precious);
    run(&format!("record emulated {} --force --count 1 --frame-id front", file.path()), 0);
    let mut records = Recording::open(file.path()).unwrap().map(|record| record.unwrap().entry);
    assert!(records.any(|entry| matches!(entry, Entry::Scan(scan) if scan.frame_id == "front")));
    assert!(fs::metadata(file.path()).unwrap().len() < 100_000, "the old content is still there");
    assert_eq!(contents(Recording::open(file.path()).unwrap()).0.len(), 1);

    let into_itself = format!("record {0} {0} --force", file.path());
    assert!(run(&into_itself, 2).stderr.contains("`urg cut "));
    assert_eq!(contents(Recording::open(file.path()).unwrap()).0.len(), 1);
}

#[test]
fn a_file_in_other_hands_ends_the_recording() {
    let file = Scratch::mcap("shared");
    let first = Running::start(&format!("record emulated {}", file.path()));
    while fs::metadata(file.path()).map_or(0, |file| file.len()) == 0 {
        std::thread::yield_now();
    }
    let line = failure(&format!("record emulated {} --force", file.path()));
    assert!(line.contains("another recorder"), "{line}");
    fs::remove_file(file.path()).unwrap();
    let (status, notices) = first.end();
    assert_eq!(status.code(), Some(1));
    assert!(notices.iter().any(|line| line.contains("was removed")), "{notices:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_path_need_not_be_utf_8() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = Scratch::new("bytes");
    fs::create_dir(folder.path()).unwrap();
    let file = std::path::Path::new(folder.path()).join(OsStr::from_bytes(b"\xff.mcap"));
    let urg = |command: &str, file: &std::path::Path, options: &str| {
        let output = program(command).arg(file).args(options.split_whitespace()).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(urg("record emulated", &file, "--count 2").0, Some(0));
    for command in ["info", "check", "scan", "stream"] {
        assert_eq!(urg(command, &file, "").0, Some(0), "{command}");
    }
    assert!(urg("serve", &file, "--listen 999.0.0.0:1").1.contains("cannot listen"));
    let (status, stderr) = urg("record", &file, "");
    assert_eq!(status, Some(2));
    assert!(stderr.starts_with("urg: which PORT?"), "{stderr}");
    let port = OsStr::from_bytes(b"/dev/tty\xff");
    assert!(urg("info", port.as_ref(), "").1.contains("expected UTF-8"));
    fs::remove_dir_all(folder.path()).unwrap();
}

#[test]
fn an_empty_file_of_a_killed_recording_is_used() {
    let (file, nobody) = (Scratch::mcap("killed-waiting"), Scratch::new("killed-waiting"));
    let mut waiting = Running::start(&format!("record {} {} --wait", nobody.path(), file.path()));
    waiting.notice();
    waiting.signal("KILL");
    waiting.end();
    assert_eq!(fs::metadata(file.path()).unwrap().len(), 0);
    run(&format!("record emulated {} --count 1", file.path()), 0);
}

#[test]
fn opening_a_recording_that_hangs_can_be_interrupted() {
    let pipe = Scratch::pipe("hangs");
    let out = Scratch::mcap("hangs-out");
    let record = format!("record {} {}", pipe.path(), out.path());
    let mut others = vec!["stream", "info", "view", "serve", "scan", "check"];
    if cfg!(any(feature = "dds", feature = "zenoh")) {
        others.push("publish");
    }
    let others = others.iter().map(|command| format!("{command} {}", pipe.path()));
    for (number, command) in others.chain([record]).enumerate() {
        // One of both is enough: one handler takes both.
        let signal = ["INT", "TERM"][number % 2];
        let script = format!("trap '' {signal}; echo; exec $urg {command}");
        let mut program = shell(&script).stdout(Stdio::piped()).spawn().unwrap();
        let mut trapped = [0];
        program.stdout.as_mut().unwrap().read_exact(&mut trapped).unwrap();
        let status = signalled(&mut program, signal);
        // A check that has found nothing out is no success, nor is a scan that is not written.
        let expected = i32::from(command.starts_with("check") || command.starts_with("scan"));
        assert_eq!(status, Some(expected), "{command}");
    }
    assert!(!fs::exists(out.path()).unwrap());
}

/// Sends a program a signal again and again until it ends, and returns its exit code.
fn signalled(program: &mut std::process::Child, signal: &str) -> Option<i32> {
    let began = Instant::now();
    loop {
        send(program.id(), signal);
        match program.try_wait().unwrap() {
            Some(status) => return status.code(),
            None if began.elapsed() < STEP_LIMIT => {}
            None => {
                program.kill().unwrap();
                program.wait().unwrap();
                return None;
            }
        }
    }
}

#[test]
fn with_one_name_only_record_asks_for_the_missing_one() {
    let stderr = run("record", 2).stderr;
    assert!(stderr.starts_with("urg: which PORT?"), "{stderr}");
    let stderr = run("record run.mcap --force", 2).stderr;
    assert!(stderr.starts_with("urg: which PORT?"), "{stderr}");
    let stderr = run("record /dev/ttyACM0 --count 3", 2).stderr;
    assert!(
        stderr.contains("FILE.mcap") && stderr.contains("`urg record /dev/ttyACM0 run.mcap`"),
        "{stderr}"
    );
    assert_eq!(stderr.matches("ttyACM0").count(), 1, "{stderr}");
}

#[test]
fn no_file_is_left_where_there_was_no_sensor() {
    let (file, nobody) = (Scratch::mcap("left"), Scratch::new("left"));
    failure(&format!("record {} {}", nobody.path(), file.path()));
    assert!(!fs::exists(file.path()).unwrap());
    let mut waiting = Running::start(&format!("record {} {} --wait", nobody.path(), file.path()));
    let notice = waiting.notice();
    assert!(notice.contains("waiting for a sensor") && notice.contains("no port"), "{notice}");
    waiting.signal("INT");
    assert_eq!(waiting.end().0.code(), Some(0));
    assert!(!fs::exists(file.path()).unwrap());
}

/// Records into a pipe, and returns the bytes read once they are more than `enough`.
fn until(pipe: &Scratch, enough: usize) -> (Running, File, Vec<u8>) {
    let running = Running::start(&format!("record emulated {} --force", pipe.path()));
    // Opening blocks until the program opens the pipe, which may have failed.
    let (sender, opened) = std::sync::mpsc::channel();
    let path = pipe.path().to_owned();
    std::thread::spawn(move || sender.send(File::open(path).unwrap()));
    let mut file = opened.recv_timeout(STEP_LIMIT).unwrap();
    let mut bytes = vec![0; enough];
    file.read_exact(&mut bytes).unwrap();
    (running, file, bytes)
}

#[test]
fn an_interrupted_recording_ends_with_its_index() {
    for signal in ["INT", "TERM", "HUP"] {
        let pipe = Scratch::pipe(&format!("interrupted-{signal}"));
        let (record, mut file, mut bytes) = until(&pipe, 10_000);
        record.signal(signal);
        file.read_to_end(&mut bytes).unwrap();
        let (status, notices) = record.end();
        assert_eq!((status.code(), notices.len()), (Some(0), 1), "{notices:?}");
        let mut recording = Recording::read(Cursor::new(bytes)).unwrap();
        let scans = recording
            .by_ref()
            .filter(|record| matches!(record.as_ref().unwrap().entry, Entry::Scan(_)));
        let stderr = notices[0].split_once(".mcap: ").unwrap().1.to_owned();
        assert!(stderr.starts_with(&format!("{} scans in ", scans.count())), "{stderr}");
        assert!(!recording.is_truncated(), "{signal}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trigger_records_the_time_before_it() {
    for trigger in ["Enter", "USR1", "INT"] {
        let (measured, mut scans) = tokio::sync::mpsc::unbounded_channel();
        let world = move |_: WorldTime, values: &mut Values| {
            values.fill(1000);
            let _ = measured.send(());
        };
        let emulator = Emulator::builder().world(world).usb().build();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap();
        tokio::spawn(async move { emulator.serve_tcp(listener).await });
        let file = Scratch::mcap(&format!("before-{trigger}"));
        let arguments = format!("record tcp://{port} {} --before 60s --count 5", file.path());
        let mut record = Running::start(&arguments);
        assert!(record.notice().ends_with("waiting for Enter or SIGUSR1"));
        for _ in 0..20 {
            scans.recv().await.unwrap();
        }
        match trigger {
            "Enter" => record.enter(),
            signal => record.signal(signal),
        }
        let (status, notices) = record.end();
        assert_eq!(status.code(), Some(0), "{notices:?}");
        let scans = Recording::open(file.path()).unwrap().scans();
        let recorded = scans.filter(Result::is_ok).count();
        match trigger {
            "INT" => assert_eq!(recorded, 0),
            // The last few may not have arrived when it was triggered.
            _ => assert!(recorded >= 20, "{recorded} scans, {notices:?}"),
        }
    }
}

#[test]
fn recording_into_a_pipe_that_nobody_reads_can_be_interrupted() {
    let pipe = Scratch::pipe("nobody-reads");
    // SIGINT is ignored until the program handles it.
    let script = format!("trap '' INT; echo; exec $urg record emulated {} --force", pipe.path());
    let mut record = shell(&script).stdout(Stdio::piped()).spawn().unwrap();
    let mut trapped = [0];
    record.stdout.as_mut().unwrap().read_exact(&mut trapped).unwrap();
    let status = signalled(&mut record, "INT");
    assert_eq!(status, Some(0));
    assert!(fs::exists(pipe.path()).unwrap(), "the program removed a pipe that it had not made");
}

#[test]
fn scans_recorded_before_a_kill_can_be_replayed() {
    let (pipe, file) = (Scratch::pipe("killed-pipe"), Scratch::mcap("killed"));
    let (record, mut rest, mut bytes) = until(&pipe, 50_000);
    record.signal("KILL");
    rest.read_to_end(&mut bytes).unwrap();
    record.end();
    fs::write(file.path(), bytes).unwrap();
    let (recorded, _) = contents(Recording::open(file.path()).unwrap());
    assert!(recorded.len() >= 10, "{} scans", recorded.len());
    let info = run(&format!("info {}", file.path()), 0).stdout;
    assert!(info.contains("its end is missing"), "{info}");
    let replay = run(&format!("stream {} --rate max", file.path()), 0);
    assert!(scans(&replay.stdout).len() >= recorded.len());
}

#[test]
fn a_full_disk_keeps_what_was_recorded() {
    let full = Scratch::mcap("full");
    let linked = Command::new("ln").args(["-s", "/dev/full", full.path()]).status().unwrap();
    assert!(linked.success());
    let line = failure(&format!("record emulated {} --force", full.path()));
    assert!(line.contains("full.mcap") || line.contains(full.path()), "{line}");
    assert!(line.contains("No space left"), "{line}");
}

#[test]
fn a_recording_outlives_the_limit_of_a_file() {
    // One second fits into a file, and two do not, nor does a second and a half.
    for count in [15, 35] {
        outlive_limit(count);
    }
}

fn outlive_limit(count: usize) {
    let file = Scratch::mcap("limited");
    let record = format!("record emulated {} --count {count} --sync 0", file.path());
    let script = format!("ulimit -f 128; exec $urg {record}");
    let output = shell(&script).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert_eq!(stderr.matches("may not grow").count(), 1, "{stderr}");
    assert!(stderr.contains(&format!("{count} scans")), "{stderr}");
    // A busy host may skip a poll, but nothing that came is lost.
    assert!(!stderr.replace("none lost", "").contains("lost"), "{stderr}");
    let stem = file.path().strip_suffix(".mcap").unwrap();
    let further = (2..).map(|number| format!("{stem}_{number:04}.mcap"));
    let parts = [file.path().to_owned()].into_iter().chain(further);
    let scans = parts.take_while(|path| fs::exists(path).unwrap()).map(|path| {
        let (scans, _) = contents(Recording::open(&path).unwrap());
        fs::remove_file(path).unwrap();
        scans.len()
    });
    let scans: Vec<_> = scans.collect();
    assert!(scans.len() > 1 && scans.iter().sum::<usize>() == count, "{scans:?}");
}

#[tokio::test(start_paused = true)]
async fn a_foreign_file_is_a_clear_error() {
    let file = Scratch::mcap("other");
    let line = failure(&format!("stream {}", file.path()));
    assert!(line.contains("cannot open") && line.contains(file.path()), "{line}");
    fs::write(file.path(), "sequence,stamp\n1,2\n").unwrap();
    let line = failure(&format!("view {}", file.path()));
    assert!(line.contains(file.path()) && line.contains("not a recording"), "{line}");
    fs::write(file.path(), "").unwrap();
    let line = failure(&format!("info {}", file.path()));
    assert!(line.contains("no scan in this recording"), "{line}");
    let usage = run("record emulated run.bag", 2).stderr;
    assert!(usage.contains("run.bag.mcap"), "{usage}");

    // A valid beginning with damage later.
    fs::remove_file(file.path()).unwrap();
    recording(file.path(), Window::DETECTION, 600).await;
    let mut bytes = fs::read(file.path()).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(file.path(), bytes).unwrap();
    let output = run(&format!("stream {} --rate max", file.path()), 1);
    assert_eq!(output.stderr.lines().count(), 1, "{}", output.stderr);
    assert!(output.stderr.contains("the recording is damaged"), "{}", output.stderr);
}

#[tokio::test(start_paused = true)]
async fn a_copy_that_would_surprise_is_refused() {
    let (file, part) = (Scratch::mcap("plain"), Scratch::mcap("surprise"));
    recording(file.path(), Window::DETECTION, 20).await;
    let (file, part) = (file.path(), part.path());
    let folder = std::path::Path::new(file).parent().unwrap().display();
    let name = std::path::Path::new(file).file_name().unwrap().display();
    let line = failure(&format!("cut {file} {folder}/./{name} {part}"));
    assert!(line.contains("named twice"), "{line}");
    let line = failure(&format!("cut {file} {part}/"));
    assert!(line.contains("expected a file"), "{line}");
    // It would not copy this topic alone.
    let line = run(&format!("cut {file} {part} --topic /scan"), 2).stderr;
    assert!(line.contains("--range"), "{line}");
    let line = run(&format!("cut {file} {part} --range -1..2"), 2).stderr;
    assert!(line.contains("expected two times"), "{line}");
    let line = failure(&format!("cut {file} {part} --range 1:00:00.."));
    assert!(line.contains("nothing in this part"), "{line}");
    let output = output_of(shell(&format!("$urg cut - {part} < /dev/null")));
    assert!(output.stderr.contains("nothing in the files"), "{}", output.stderr);
    assert!(!fs::exists(part).unwrap());
    let output = output_of(shell(&format!("$urg cut {file} - > /dev/full; echo $?")));
    assert_eq!(output.stdout, "1\n");
    let start = "urg: incomplete copy: No space";
    assert!(output.stderr.starts_with(start), "{}", output.stderr);
}
