//! Sensors of SCIP 2 on Ethernet, and a URG-04LX that is asked for it.

use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Firmware, Model, Values, WorldTime};
use urg_recording::Recorder;

use super::formats::{scans, values};
use super::program::{Scratch, run};
use super::web::{Served, on_tcp};

/// Returns the port of an emulated UST-10LX.
fn ust() -> (Runtime, String) {
    on_tcp(Emulator::builder().model(Model::Ust10lx).build())
}

#[test]
fn info_shows_what_a_model_measures() {
    let (_runtime, port) = ust();
    let text = run(&format!("info {port}"), 0).stdout;
    for row in [
        "product        UST-10LX",
        "protocol       SCIP 2 (its own text: SCIP 2.2)",
        "measures       20 to 30000 mm",
        "window         steps 0 to 1080, -135.00° to 135.00°, 0.250° apart",
        "motor          2400 rpm nominal: 40 revolutions",
        "state          sensor is working normally, Measuring by Sensitive Mode",
        "sensor time    0:0",
    ] {
        assert!(text.contains(row), "{row} is not in\n{text}");
    }
    let json = run(&format!("info {port} --format json"), 0).stdout;
    let info: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&info["protocol"], &info["revolution"]), (&"SCIP 2".into(), &0.025.into()));
    assert_eq!(info["geometry"]["last_step"], 1080);
}

#[test]
fn a_window_has_the_steps_of_the_model() {
    let (_runtime, port) = ust();
    let scan = |window: &str| {
        let scan = run(&format!("scan {port} --format json {window}"), 0).stdout;
        let scan = scans(&scan).remove(0);
        (scan["start"].as_u64().unwrap(), scan["end"].as_u64().unwrap())
    };
    assert_eq!(scan(""), (0, 1080));
    assert_eq!(scan("--window 0..1080"), (0, 1080));
    assert_eq!(scan("--from -90 --to 90deg"), (180, 900));
    assert_eq!(scan("--from 0"), (540, 1080));
    assert_eq!(scan("--to 0"), (0, 540));
    let error = run(&format!("scan {port} --window 0..1081"), 1).stderr;
    assert!(error.contains("this sensor measures steps 0..=1080"), "{error}");
    assert_eq!(scan("--window full"), (0, 1080));
    let error = run("scan emulated --window 0..1080", 1).stderr;
    assert!(error.contains("this sensor measures steps 44..=725"), "{error}");
    // A stream would wait for another sensor.
    let file = Scratch::mcap("window");
    for command in [format!("stream {port}"), format!("record {port} {}", file.path())] {
        let error = run(&format!("{command} --window 0..1081"), 1).stderr;
        assert!(error.contains("this sensor measures steps 0..=1080"), "{error}");
    }
}

#[test]
fn a_protocol_can_be_asked_for() {
    let (_runtime, port) = ust();
    let error = run(&format!("info {port} --protocol scip1"), 1).stderr;
    assert!(error.contains("speaks SCIP 2") && error.contains("asked for SCIP 1.1"), "{error}");
    run(&format!("info {port} --protocol scip2"), 0);
    let text = run("info emulated --protocol scip2", 0).stdout;
    assert!(text.contains("20 to 5600 mm"), "{text}");
    let (_runtime, port) = on_tcp(Emulator::builder().firmware(Firmware::Text).build());
    let error = run(&format!("info {port} --protocol scip2 --timeout 2s"), 1).stderr;
    assert!(error.contains("has no SCIP 2: leave out --protocol"), "{error}");
    let text = run("info emulated --protocol scip1", 0).stdout;
    assert!(text.contains("20 to 4094 mm"), "{text}");
}

#[test]
fn the_state_has_what_the_page_needs_of_a_model() {
    let (_runtime, port) = ust();
    let served = Served::start(&format!("{port} --from 0"));
    served.get("/scans?max=3").text();
    let state = served.state();
    // The driver has the intervals of these scans, which are no latency.
    assert!(state["stats"]["reply_latency"]["count"].as_u64() > Some(0), "{state}");
    assert_eq!(state["latency"], Value::Null);
    assert_eq!(state["geometry"]["max_distance"], 30_000);
    assert_eq!(state["codes"]["65533"]["meaning"], "nothing in range");
    assert_eq!((&state["reach"], &state["window"]["end"]), (&30.6.into(), &1080.into()));
    let served = Served::start("emulated");
    served.get("/scans?max=1").line().unwrap();
    let state = served.state();
    let code = &state["codes"]["7"]["meaning"];
    assert_eq!(code, "Distance data on the preceding and succeeding steps have errors");
    assert!(state["latency"]["max"].as_f64() > Some(0.0), "{state}");
}

#[test]
fn a_rate_that_a_model_does_not_reach_is_told() {
    let (_runtime, port) = ust();
    let output = run(&format!("stream {port} --rate 90 --duration 8s"), 0);
    assert!(output.stderr.contains("where 90 Hz was asked for"), "{}", output.stderr);
}

#[test]
fn a_picture_is_as_large_as_the_room() {
    let (_runtime, port) = ust();
    let svg = run(&format!("scan {port} --format svg"), 0).stdout;
    for text in ["UST-10LX H0713090", ">6 m<", "(-135.0° to 135.0°)", "A colour for each 1 m."] {
        assert!(svg.contains(text), "{text}");
    }
    assert!(!svg.contains(">8 m<"), "{svg}");
    let csv = run(&format!("scan {port} --format csv"), 0).stdout;
    assert!(csv.lines().any(|row| row.ends_with(",65533")), "{csv}");
}

/// Intensity that the emulator has for each of these values.
fn reflected(values: &[u64]) -> Vec<Value> {
    let of = |value: u64| if value == 65_533 { 0 } else { (2_000_000 / (value + 1000)).max(370) };
    values.iter().map(|value| of(*value).into()).collect()
}

#[test]
fn intensities_are_in_each_format_if_asked_for() {
    let (_runtime, port) = ust();
    let scan = |port: &str, options: &str| run(&format!("scan {port} {options}"), 0).stdout;
    let scanned = scans(&scan(&port, "--format json --intensity")).remove(0);
    assert_eq!(scanned["intensities"], Value::Array(reflected(&values(&scanned))));
    let without = scans(&scan(&port, "--format json")).remove(0);
    assert!(without.get("intensities").is_none(), "{without}");

    let csv = run(&format!("stream {port} --format csv --intensity --count 1"), 0).stdout;
    let mut rows = csv.lines();
    assert_eq!(rows.next(), Some("sequence,stamp,time,step,angle,range,intensity,code"));
    assert_eq!(rows.clone().count(), 1081);
    for row in rows {
        let row: Vec<_> = row.split(',').collect();
        let [.., range, intensity, code] = row[..] else { panic!("{row:?}") };
        let value = if code.is_empty() {
            (range.parse::<f64>().unwrap() * 1000.0).round() as u64
        } else {
            assert_eq!(range, "");
            code.parse().unwrap()
        };
        assert_eq!(intensity, reflected(&[value])[0].to_string(), "{row:?}");
    }
    let table = scan(&port, "--intensity");
    assert!(table.starts_with("step  direction  intensity   distance\n"), "{table}");
    let point = table.lines().nth(541).unwrap();
    let [step, _, intensity, metres, "m"] = *point.split_whitespace().collect::<Vec<_>>() else {
        panic!("{point}")
    };
    let value = metres.replace('.', "").parse().unwrap();
    assert_eq!((step, intensity), ("540", &*reflected(&[value])[0].to_string()));

    let served = Served::start(&format!("{port} --intensity"));
    let line = served.get("/scans?max=1").line().unwrap();
    let served = &scans(&line)[0];
    assert_eq!(served["intensities"], Value::Array(reflected(&values(served))));
}

#[test]
fn a_picture_shows_intensities_as_shades() {
    // Intensities of 1,000 on the right, 370 on the left.
    let world = |_: WorldTime, values: &mut Values| {
        values.fill(7000);
        values[..300].fill(1000);
    };
    let emulator = Emulator::builder().model(Model::Ust10lx).world(world).build();
    let (_runtime, port) = on_tcp(emulator);
    let svg = run(&format!("scan {port} --format svg --intensity"), 0).stdout;
    let count = |class: &str| svg.matches(&format!("<circle class=\"{class}\"")).count();
    assert_eq!((count("d3"), count("d2")), (300, 781));
    assert!(svg.contains("Shades of intensity: 64 to 16384, each twice the last."), "{svg}");
    assert!(svg.contains(".d0 { fill: #9087f6 }"), "{svg}");
    let without = run(&format!("scan {port} --format svg"), 0).stdout;
    assert!(!without.contains("#9087f6") && without.contains("A colour for each 1 m."));
}

#[test]
fn a_sensor_without_intensities_measures_none() {
    let output = run("scan emulated --intensity --format json", 0);
    assert_eq!(output.stderr, "urg: emulated has no intensities\n");
    let scan = output.stdout;
    assert!(scans(&scan)[0].get("intensities").is_none(), "{scan}");
    let csv = run("scan emulated --intensity --format csv-xy", 0).stdout;
    assert!(csv.lines().next().unwrap().ends_with(",range,intensity,code,x,y"), "{csv}");
    for row in csv.lines().skip(1) {
        let row: Vec<_> = row.split(',').collect();
        assert_eq!((row.len(), row[6]), (10, ""), "{row:?}");
    }
    let table = run("scan emulated --intensity", 0).stdout;
    assert!(table.starts_with("step  direction   distance\n"), "{table}");
}

#[test]
fn recorded_messages_of_ros_have_intensities() {
    let (_runtime, port) = ust();
    let file = Scratch::mcap("intensities");
    run(&format!("record {port} {} --intensity --count 3 --compress none", file.path()), 0);
    let bytes = std::fs::read(file.path()).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let is_scan = |message: &mcap::Message<'_>| {
        let schema = message.channel.schema.as_ref();
        schema.is_some_and(|schema| schema.name == "sensor_msgs/msg/LaserScan")
    };
    let scans: Vec<_> = messages.filter(is_scan).collect();
    assert_eq!(scans.len(), 3);
    for scan in scans {
        let numbers: Vec<[u8; 4]> =
            scan.data.rchunks(4).rev().map(|bytes| bytes.try_into().unwrap()).collect();
        let [.., ranges, intensities] = *numbers.rchunks(1082).rev().collect::<Vec<_>>() else {
            panic!("{} numbers", numbers.len())
        };
        for sequence in [ranges, intensities] {
            assert_eq!(u32::from_le_bytes(sequence[0]), 1081);
        }
        for (range, intensity) in ranges.iter().zip(intensities).skip(1) {
            let [range, intensity] = [range, intensity].map(|bytes| f32::from_le_bytes(*bytes));
            let value = if range.is_finite() { (range * 1000.0).round() as u64 } else { 65_533 };
            assert_eq!(Some(f64::from(intensity)), reflected(&[value])[0].as_f64(), "{range}");
        }
    }
}

#[test]
fn a_replay_invents_no_intensities() {
    let (_runtime, port) = ust();
    for (option, has) in [("", false), ("--intensity", true)] {
        let file = Scratch::mcap("replayed");
        run(&format!("record {port} {} {option} --count 3", file.path()), 0);
        let info = run(&format!("info {}", file.path()), 0).stdout;
        assert_eq!(info.contains(" Hz, with intensities\n"), has, "{info}");
        let read = format!("stream {} --intensity --format ndjson --count 1", file.path());
        let output = run(&read, 0);
        let scan = scans(&output.stdout).remove(0);
        assert_eq!(scan.get("intensities").is_some(), has, "{scan}");
        assert_eq!(output.stderr.contains("has no intensities"), !has, "{}", output.stderr);
    }
}

#[test]
fn a_connection_that_is_closed_may_be_a_sensor_that_boots() {
    let runtime = Runtime::new().unwrap();
    let listener = runtime.block_on(TcpListener::bind(("127.0.0.1", 0))).unwrap();
    let port = listener.local_addr().unwrap();
    runtime.spawn(async move {
        while let Ok((mut peer, _)) = listener.accept().await {
            let _ = peer.shutdown().await;
        }
    });
    let error = run(&format!("info tcp://{port}"), 1).stderr;
    assert!(error.contains("may still boot, or serve another client"), "{error}");
}

#[test]
fn a_recording_has_as_many_scans_as_asked_for() {
    let models = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];
    let record = |model, rate| {
        let (_runtime, port) = on_tcp(Emulator::builder().model(model).build());
        let file = Scratch::mcap("counted");
        run(&format!("record {port} {} --count 30 {rate}", file.path()), 0);
        let info = run(&format!("info {}", file.path()), 0).stdout;
        assert!(info.contains("scans          30 of "), "{model:?} {rate}\n{info}");
    };
    // Not all at once: of a program that is late by 500 ms, replies are written without their scans.
    for rate in ["", "--rate 10", "--rate 7", "--rate 30", "--rate max"] {
        std::thread::scope(|scope| {
            for model in models {
                scope.spawn(move || record(model, rate));
            }
        });
    }
}

#[test]
fn a_recording_of_two_sensors_is_read_as_the_first() {
    let models = [(Model::Urg04lx, "H1"), (Model::Ust10lx, "U2")];
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::thread::scope(|scope| {
        for (model, number) in models {
            let file = path(&format!("{number}.mcap"));
            scope.spawn(move || {
                let sensor = Emulator::builder().model(model).serial_number(number).build();
                let (_runtime, port) = on_tcp(sensor);
                run(&format!("record {port} {file} --duration 2s"), 0);
            });
        }
    });
    let both = path("both.mcap");
    run(&format!("cut {} {} {both}", path("H1.mcap"), path("U2.mcap")), 0);

    let streamed = run(&format!("stream {both} --rate max --format ndjson"), 0);
    let all = scans(&streamed.stdout);
    let info = run(&format!("info {both} --format json"), 0).stdout;
    let info: Value = serde_json::from_str(&info).unwrap();
    assert_eq!(info["scans"], all.len());
    let last_step = &info["geometry"]["last_step"];
    let number = match last_step.as_u64() {
        Some(1080) => "U2",
        _ => "H1",
    };
    assert_eq!(info["version"]["serial_number"], number);
    let alone = run(&format!("info {} --format json", path(&format!("{number}.mcap"))), 0).stdout;
    let alone: Value = serde_json::from_str(&alone).unwrap();
    for key in ["scans", "geometry", "version", "losses", "gaps", "revolution"] {
        assert_eq!(info[key], alone[key], "{key}");
    }
    let text = run(&format!("info {both}"), 0).stdout;
    let left_out = text.lines().find_map(|row| row.strip_prefix("left out ")).unwrap().trim();
    assert!(left_out.contains(" of another laser scanner"), "{left_out}");
    for said in [&streamed.stderr, &run(&format!("check {both}"), 0).stdout] {
        assert!(said.contains(left_out), "{said}");
    }
}

#[test]
fn a_recording_of_a_model_is_read_as_the_sensor() {
    let (_runtime, port) = ust();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let path = path.display();
    run(&format!("record {port} {path} --count 20"), 0);
    let info = run(&format!("info {path}"), 0).stdout;
    for row in ["scans          20 of steps 0..=1080", "20 to 30000 mm", "left out       none"] {
        assert!(info.contains(row), "{row} is not in\n{info}");
    }
    run(&format!("check {path}"), 0);
    let part = folder.path().join("part.mcap");
    run(&format!("cut {path} {} --range 100ms..", part.display()), 0);
    for (file, least) in [(path.to_string(), 20), (part.display().to_string(), 10)] {
        let text = run(&format!("stream {file} --format ndjson --rate max"), 0).stdout;
        let all = scans(&text);
        assert!(all.len() >= least, "{}", all.len());
        let last = all.last().unwrap();
        assert_eq!((&last["start"], &last["end"]), (&0.into(), &1080.into()));
        assert_eq!(last["values"].as_array().unwrap().len(), 1081);
    }
}

/// Without its reply to `V`, the metadata name a sensor.
#[tokio::test]
async fn info_shows_the_first_sensor_of_a_joined_recording() {
    let [ust, urg, both] = ["ust", "urg", "both-models"].map(Scratch::mcap);
    for (model, file) in [(Model::Ust10lx, &ust), (Model::Urg04lx, &urg)] {
        let emulator = Emulator::builder().model(model).build();
        let sensor = Sensor::builder().connect(emulator).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        let mut recorder = Recorder::create(file.path()).unwrap();
        recorder.describe(&sensor, &scans).await.unwrap();
        recorder.record(&scans.next().await.unwrap()).unwrap();
        recorder.finish().await.unwrap();
    }
    run(&format!("cut {} {} {}", ust.path(), urg.path(), both.path()), 0);
    let info = run(&format!("info {}", both.path()), 0).stdout;
    assert!(info.contains("UST-10LX") && info.contains("20 to 30000 mm"), "{info}");
}
