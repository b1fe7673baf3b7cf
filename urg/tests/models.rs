//! Sensors of SCIP 2 on Ethernet, and a URG-04LX that is asked for it.

use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use urg_emulator::{Emulator, Model};

use super::formats::scans;
use super::program::run;
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
        "measures       23 to 60000 mm",
        "window         steps 0 to 1080, -135.00° to 135.00°, 0.250° apart",
        "motor          2400 rpm nominal: 40 revolutions",
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
    let error = run("scan emulated --window 0..1080", 1).stderr;
    assert!(error.contains("this sensor measures steps 44..=725"), "{error}");
}

#[test]
fn a_protocol_can_be_asked_for() {
    let (_runtime, port) = ust();
    let error = run(&format!("info {port} --protocol scip1"), 1).stderr;
    assert!(error.contains("speaks SCIP 2") && error.contains("asked for SCIP 1.1"), "{error}");
    run(&format!("info {port} --protocol scip2"), 0);
    let text = run("info emulated --protocol scip2", 0).stdout;
    assert!(text.contains("20 to 5600 mm"), "{text}");
    let text = run("info emulated --protocol scip1", 0).stdout;
    assert!(text.contains("20 to 4094 mm"), "{text}");
}

#[test]
fn the_state_has_what_the_page_needs_of_a_model() {
    let (_runtime, port) = ust();
    let served = Served::start(&format!("{port} --from 0"));
    served.get("/scans?max=1").line().unwrap();
    let state = served.state();
    assert_eq!(state["geometry"]["max_distance"], 60_000);
    assert_eq!(state["codes"]["65533"]["meaning"], "nothing in range");
    assert_eq!((&state["reach"], &state["window"]["end"]), (&61.2.into(), &1080.into()));
    let served = Served::start("emulated");
    served.get("/scans?max=1").line().unwrap();
    let code = &served.state()["codes"]["7"]["meaning"];
    assert_eq!(code, "Distance data on the preceding and succeeding steps have errors");
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
