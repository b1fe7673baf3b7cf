//! Help, invalid command lines, and ports that cannot be opened.

use super::program::{COMMANDS, Emulated, Scratch, failure, output_of, program, run};

#[test]
fn every_command_has_help_on_standard_output() {
    let help = run("--help", 0).stdout;
    assert!(help.contains("emulated"));
    for arguments in ["help", "help --help", "help -h"] {
        assert_eq!(run(arguments, 0).stdout, help, "{arguments}");
    }
    assert_eq!(run("help stream --help", 0).stdout, run("help stream", 0).stdout);
    for command in COMMANDS.iter().chain(&["man"]) {
        let long = run(&format!("{command} --help"), 0).stdout;
        let short = run(&format!("help {command}"), 0).stdout;
        for help in [long, short] {
            assert!(help.contains(&format!("Usage: urg {command}")), "{help}");
        }
    }
    for command in COMMANDS.iter().chain(&["man", "publish"]) {
        assert!(help.contains(&format!("\n  {command} ")), "{command} in\n{help}");
    }
    assert!(run("--version", 0).stdout.starts_with("urg "));
}

#[test]
fn the_help_explains_each_member_of_a_scan() {
    let help = run("help stream", 0).stdout;
    let line = run("stream emulated --count 1 --format ndjson", 0).stdout;
    let scan: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&line).unwrap();
    let explained = |name: &str| {
        help.lines().any(|line| line.split([' ', ',']).take(5).any(|word| word == name))
    };
    let missing: Vec<_> = scan.keys().filter(|name| !explained(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn baud_takes_the_options_of_the_link_but_another_baud_rate() {
    let help = run("help baud", 0).stdout;
    let options: Vec<_> = ["--protocol", "--wait", "--timeout", "--baud", "--intensity"]
        .into_iter()
        .filter(|option| help.contains(option))
        .collect();
    assert_eq!(options, ["--protocol", "--wait", "--timeout"]);
}

/// A recording has nothing to switch.
#[test]
fn commands_that_change_a_sensor_offer_no_recording() {
    for (command, argument) in [("laser", "<on|off>"), ("baud", "<RATE>"), ("reboot", "")] {
        let help = run(&format!("{command} -h"), 0).stdout;
        assert!(help.contains("serial:NUMBER") && !help.contains("FILE"), "{help}");
        // The argument is beside PORT, before all options.
        let arguments = help.split("\nArguments:\n").nth(1).unwrap();
        assert!(arguments.split("\n\n").next().unwrap().contains(argument), "{help}");
        assert!(!help.contains("--intensity"), "{help}");
    }
}

/// A build without some compression suggests no command that needs it.
#[test]
fn the_example_of_a_compression_works_in_this_build() {
    let help = run("help cut", 0).stdout;
    let example = help.lines().find(|line| line.contains("--compress ") && line.contains(".mcap"));
    let name = example.unwrap().split("--compress ").nth(1).unwrap();
    let values = help.lines().find(|line| line.contains("[possible values: ")).unwrap();
    assert!(values.contains(name), "{name} in {values}");
}

#[cfg(not(any(feature = "dds", feature = "zenoh", feature = "foxglove")))]
#[test]
fn publish_says_how_to_build_it() {
    for arguments in ["publish emulated --frame-id laser", "publish --help"] {
        let output = run(arguments, 2);
        assert!(output.stderr.contains("cargo install --path urg --features dds"), "{arguments}");
    }
}

#[test]
fn an_invalid_command_line_exits_with_2() {
    for arguments in [
        "",
        "fly",
        "stream emulated --fast",
        "stream tcp://bridge:",
        "stream emulated --rate 0",
        "stream emulated --count 0",
        "stream emulated --duration 0s",
        "stream emulated --baud 9600",
        "stream emulated --format svg",
        "scan emulated --cluster 0",
        "scan emulated --window 0..10000",
        "scan emulated --window 700..30",
        "scan emulated --from 20 --to 10",
        "scan emulated --from nan",
        "scan emulated --from inf",
        "scan emulated --to 1rad",
        "scan emulated --from 10 --window full",
        "view emulated",
        "view emulated --count 3",
        "check emulated --duration 0s",
        "completions cmd",
        "man fly",
        "list --format csv",
        "laser emulated",
        "laser emulated blink",
        "baud emulated",
        "emulate --faults rain=0.5",
        "emulate --tcp 4001 --link here",
        "emulate --model utm-30lx --baud 19200",
        "emulate --model ust-10lx --firmware v3",
        "emulate --serial-number=",
        "emulate --model lms100",
    ] {
        let output = run(arguments, 2);
        assert_eq!(output.stdout, "", "{arguments}");
        assert!(!output.stderr.is_empty(), "{arguments}");
    }
}

#[test]
fn help_that_cannot_be_written_is_a_failure() {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    for arguments in ["help", "--version", "stream --help"] {
        let output = program(arguments).stdout(full.try_clone().unwrap()).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments}: {stderr}");
        assert!(stderr.contains("cannot write to standard output"), "{arguments}: {stderr}");
    }
}

#[test]
fn a_missing_port_is_asked_for() {
    for arguments in
        ["info", "scan --format csv", "stream --count 3", "check", "laser on", "baud 115200"]
    {
        let output = run(arguments, 2);
        assert!(output.stderr.starts_with("urg: which PORT?"), "{}", output.stderr);
    }
    // The emulated sensor cannot restart.
    let reboot = run("reboot", 2).stderr;
    assert!(reboot.contains("Try `urg reboot ") && !reboot.contains("emulated"), "{reboot}");
}

#[test]
fn each_failure_is_one_line_that_names_the_port() {
    let missing = Scratch::new("missing");
    let directory = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("no-recordings");
    std::fs::create_dir_all(&directory).unwrap();
    for command in ["info", "scan", "stream"] {
        let line = failure(&format!("{command} {}", missing.path()));
        assert!(line.contains("no port") && line.contains(missing.path()), "{line}");
        let line = failure(&format!("{command} {}", directory.display()));
        assert!(line.contains("no recording in the folder"), "{line}");
    }
    // A port of this machine that was free a moment ago.
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let line = failure(&format!("info tcp://{free}"));
    assert!(line.contains(&format!("tcp://{free}")) && line.contains("refused"), "{line}");
    let line = failure("laser serial:H0000000 on");
    assert!(line.contains("H0000000"), "{line}");
}

#[test]
fn a_port_in_use_is_reported_as_such() {
    let link = Scratch::new("in-use");
    let sensor = Emulated::start(&format!("--link {}", link.path()));
    let mut stream = super::program::Running::start(&format!("stream {}", sensor.port));
    stream.line();
    // Root may open it nevertheless.
    let output = output_of(program(&format!("info {}", sensor.port)));
    let is_told = output.stderr.contains("is in use");
    assert!(output.code == Some(0) || is_told, "{}", output.stderr);
}

#[test]
fn an_emulated_sensor_that_cannot_be_served_is_a_failure() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap();
    let line = failure(&format!("emulate --tcp {taken}"));
    assert!(line.contains("cannot serve on 127.0.0.1"), "{line}");
    assert!(line.contains("; --tcp chooses another address"), "{line}");
    let line = failure(&format!("serve emulated --listen {taken}"));
    assert!(line.contains("cannot listen on 127.0.0.1"), "{line}");
    assert!(line.contains("; --listen chooses another address"), "{line}");
    #[cfg(feature = "foxglove")]
    {
        let publish = format!("publish emulated --engine foxglove --listen {taken}");
        let line = super::program::Running::start(&publish).notice();
        assert!(line.contains("cannot serve Foxglove on 127.0.0.1"), "{line}");
        assert!(line.contains(" (--listen chooses another address): "), "{line}");
    }
    let file = Scratch::new("file");
    let line = failure(&format!("emulate --link {}/urg", file.path()));
    assert!(line.contains(&format!("; there is no folder {}: create", file.path())), "{line}");
    std::fs::write(file.path(), "mine").unwrap();
    failure(&format!("emulate --link {}", file.path()));
    assert_eq!(std::fs::read(file.path()).unwrap(), b"mine");
}

#[cfg(unix)]
#[test]
fn a_missing_folder_is_named() {
    let folder = Scratch::new("no-folder");
    let new = format!("{}/run.mcap", folder.path());
    let file = Scratch::mcap("in-a-folder");
    run(&format!("record emulated {} --count 2", file.path()), 0);
    for command in [format!("record emulated {new}"), format!("cut {} {new}", file.path())] {
        let line = failure(&command);
        let advice = format!("; there is no folder {}: create it first\n", folder.path());
        assert!(line.contains(&new) && line.ends_with(&advice), "{line}");
    }
    // A link to such a file is in a folder.
    let link = Scratch::mcap("linked");
    std::os::unix::fs::symlink(&new, link.path()).unwrap();
    let line = failure(&format!("record emulated {} --force", link.path()));
    assert!(line.contains("No such file") && !line.contains("no folder"), "{line}");
}

#[test]
fn logs_come_on_standard_error_and_only_when_asked_for() {
    let quiet = run("info emulated", 0);
    assert!(quiet.stderr.is_empty());
    let mut asked = program("info emulated");
    asked.env("RUST_LOG", "debug");
    let asked = output_of(asked);
    assert_eq!(asked.code, Some(0));
    assert!(!asked.stderr.is_empty());
    assert_eq!(asked.stdout, quiet.stdout);
}

#[test]
fn the_ports_of_this_machine_can_be_listed() {
    run("list", 0);
}

#[test]
fn a_misspelt_or_misplaced_word_gets_a_hint() {
    for (arguments, hint) in [
        ("stream emulatd", "did you mean `emulated`?"),
        ("laser off emulated", "expected a port, and off after it"),
        ("baud 115200 emulated", "expected a port, and 115200 after it"),
        ("laser emulated of", "expected on or off, after PORT"),
        ("laser emulated --wait off", "after PORT and before options"),
        ("baud emulated --wait 57600", "or 750000, after PORT and before options"),
        ("steam emulated", "'stream'"),
        ("scan emulated --window half", "such as 44..725"),
        ("stream emulated --rate -1", "expected more than 0 and at most 1000 Hz"),
        ("emulate --faults noise=1:99999999999999", "up to 65536"),
        ("stream emulated --duration -5s", "expected a time above 0"),
        ("stream emulated --timeout -5s", "expected a time above 0"),
        ("check emulated --duration -5s", "expected a time above 0"),
        ("record emulated never.mcap --sync -1s", "expected a time above 0"),
        ("emulate --serial-number a\x1bb", "expected text without control characters"),
    ] {
        let stderr = run(arguments, 2).stderr;
        assert!(stderr.contains(hint), "{arguments}: {stderr}");
        assert!(!stderr.contains("tip: to pass"), "{arguments}: {stderr}");
    }
}

#[test]
fn a_window_has_a_name_or_two_steps() {
    let full = run("scan emulated --format json --window full", 0).stdout;
    assert!(full.contains("\"start\":0,\"end\":768,"), "{full}");
    let steps = run("scan emulated --format json --window 100..200 --cluster 2", 0).stdout;
    assert!(steps.contains("\"start\":100,\"end\":200,\"cluster\":2,"), "{steps}");
}

#[test]
fn a_search_for_the_sensor_ends_at_its_timeout() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let began = std::time::Instant::now();
    failure(&format!("info tcp://{} --timeout 500ms", listener.local_addr().unwrap()));
    assert!(began.elapsed() < std::time::Duration::from_secs(4), "{:?}", began.elapsed());
}

#[cfg(target_os = "linux")]
#[test]
fn a_second_emulator_takes_no_used_link() {
    let link = Scratch::new("claimed");
    let first = Emulated::start(&format!("--link {}", link.path()));
    let line = failure(&format!("emulate --link {}", link.path()));
    assert!(line.contains("use another --link, or replace it with --force"), "{line}");
    run(&format!("info {}", first.port), 0);
    first.running.signal("KILL");
    first.running.end();
    // Another program may have the terminal of the killed one by now.
    std::fs::remove_file(link.path()).unwrap();
    std::os::unix::fs::symlink("/dev/pts/999999", link.path()).unwrap();
    let second = Emulated::start(&format!("--link {}", link.path()));
    run(&format!("info {}", second.port), 0);
}

#[test]
fn bytes_that_are_no_reply_are_quoted_or_counted() {
    use std::io::{Read, Write};
    // A receiver of satellites, as text and in its binary form, answers whatever it is asked with its place.
    for (place, expected) in [
        (&b"$GPGGA,123519,4807\r\n"[..], "found the text \"$GPGGA,123519,4807"),
        (b"\xb5\x62\x01\x07\x80\n", "bytes that are not a SCIP reply"),
    ] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let mut client = client.unwrap();
                let mut command = [0; 64];
                while client.read(&mut command).is_ok_and(|count| count > 0)
                    && client.write_all(place).is_ok()
                {}
            }
        });
        for command in ["info", "check"] {
            let output = run(&format!("{command} tcp://{address} --timeout 1s"), 1);
            let text = output.stdout + &output.stderr;
            assert!(text.contains(expected), "{text}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_recording_has_nothing_to_switch() {
    let file = Scratch::mcap("switched");
    super::recorded::recording(file.path(), tokio_scip::Window::DETECTION, 3).await;
    for command in [
        "laser PORT off",
        "baud PORT 19200",
        "reboot PORT",
        "check PORT --duration 1m",
        "check PORT --baud 19200",
    ] {
        let stderr = run(&command.replace("PORT", file.path()), 2).stderr;
        assert!(stderr.contains("is a recording"), "{stderr}");
    }
}

#[cfg(unix)]
#[test]
fn an_emulator_replaces_only_its_own_link() {
    let link = Scratch::new("foreign-link");
    std::os::unix::fs::symlink("/etc/hostname", link.path()).unwrap();
    let stderr = failure(&format!("emulate --link {}", link.path()));
    assert!(stderr.contains("it is a link to /etc/hostname"), "{stderr}");
    assert_eq!(std::fs::read_link(link.path()).unwrap().to_str(), Some("/etc/hostname"));
    let sensor = Emulated::start(&format!("--force --link {}", link.path()));
    run(&format!("info {}", sensor.port), 0);
}
