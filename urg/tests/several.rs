//! Several sensors on one page: each has its name, its place and its own trouble.

use std::collections::BTreeSet;

use serde_json::Value;

use super::program::{Emulated, Running, Scratch, run};
use super::web::Served;

#[test]
fn each_line_names_its_sensor() {
    let served = Served::start("front=emulated@0.2,0,0 rear=emulated@-0.2,0.5,180,upside-down");
    let mut scans = served.get("/scans");
    let mut seen = BTreeSet::new();
    while seen.len() < 2 {
        let line: Value = serde_json::from_str(&scans.line().unwrap()).unwrap();
        seen.insert(line["sensor"].as_str().unwrap().to_owned());
        assert!(line["values"].is_array() || line["event"].is_string(), "{line}");
    }
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), ["front", "rear"]);
    let state = served.json("/state");
    let rear = &state["sensors"][1];
    let place = serde_json::json!({ "x": -0.2, "y": 0.5, "yaw": 180.0, "upside_down": true });
    assert_eq!(rear["pose"], place);
    assert!(rear["stats"]["scans"].as_u64().unwrap() > 0, "{rear}");
    let metrics = served.get("/metrics").text();
    for name in ["front", "rear"] {
        assert!(metrics.contains(&format!("urg_up{{sensor=\"{name}\"}} 1\n")), "{metrics}");
    }
}

#[test]
fn the_trouble_of_one_sensor_is_that_of_no_other() {
    let link = Scratch::new("one-of-two");
    let sensor = Emulated::start(&format!("--link {}", link.path()));
    let served = Served::start(&format!("front=emulated rear={}", link.path()));
    served.health(200);
    drop(sensor);
    let health = served.health(503);
    let status = |at: usize| health["sensors"][at]["status"].clone();
    assert_eq!((status(0), status(1)), ("ok".into(), "failing".into()), "{health}");
    // The other one's scans still come.
    let mut scans = served.get("/scans");
    let mut fronts = 0;
    while fronts < 5 {
        let line: Value = serde_json::from_str(&scans.line().unwrap()).unwrap();
        fronts += i32::from(line["sensor"] == "front" && line["values"].is_array());
    }
    // Another program may have its pseudo-terminal by now.
    let _sensor = Emulated::start(&format!("--force --link {}", link.path()));
    served.health(200);
}

#[test]
fn an_absent_sensor_does_not_hide_the_others() {
    let nobody = Scratch::new("not-there");
    let both = format!("front=emulated rear={}", nobody.path());
    let mut running = Running::start(&format!("serve {both} --listen 0"));
    let notice = running.notice();
    assert!(
        notice.contains(nobody.path()) && notice.ends_with("; the others continue"),
        "{notice}"
    );
    let notice = running.notice();
    let served = Served::announced(running, &notice);
    // Once its first scan is there, the one that was found is well.
    served.get("/scans?max=1").text();
    let health = served.health(503);
    assert_eq!(health["sensors"][1]["link"], "closed", "{health}");
    assert_eq!(health["sensors"][0]["status"], "ok", "{health}");
    // Where there is no other one the program ends.
    run(&format!("serve a={0} b={0} --listen 0", nobody.path()), 1);
}

#[test]
fn a_name_that_stands_twice_is_named() {
    let line = run("serve left=emulated left=emulated", 2).stderr;
    assert!(line.contains("two sensors are named left"), "{line}");
}

#[test]
fn several_sensors_need_names_and_places() {
    for arguments in
        ["emulated emulated", "front=emulated emulated", "a=emulated a=emulated", "1=emulated", ""]
    {
        run(&format!("serve {arguments}"), 2);
        run(&format!("view {arguments}"), 2);
    }
    for place in [
        "1,2",
        "1,2,3,4",
        "1,2,3,90,0",
        "1,2,x",
        "1,2,inf",
        "1,,2",
        "1e8,0,0",
        "0,-1001,0",
        "0,0,361",
    ] {
        let stderr = run(&format!("view a=emulated@{place}"), 2).stderr;
        assert!(stderr.contains("expected X,Y,YAW"), "{place}: {stderr}");
    }
}
