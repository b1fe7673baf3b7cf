//! Scans and related types as data (feature `serde`), in the documented shape.

use std::time::{Duration, UNIX_EPOCH};

use serde_json::{Value, json};
use tokio_scip::protocol::scip2;
use tokio_scip::{Endpoint, Error, Measurement, Rate, Scan, Sensor, State, Window};
use urg_emulator::{Emulator, Values, WorldTime};

/// Returns a sensor that measures a distance, two error codes and saturation.
async fn sensor() -> (Sensor, Emulator) {
    let emulator = Emulator::builder()
        .world(|_: WorldTime, codes: &mut Values| {
            codes[382..=385].copy_from_slice(&[1234, 0, 7, 4095])
        })
        .build();
    (Sensor::builder().connect(emulator.clone()).await.unwrap(), emulator)
}

async fn scan() -> Scan {
    let (sensor, _) = sensor().await;
    sensor.scan(Window::new(382..=385).unwrap()).await.unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_scan_is_one_line_of_ndjson() {
    let scan = scan().await;
    let text = serde_json::to_string(&scan).unwrap();
    let micros = scan.times().stamp.duration_since(UNIX_EPOCH).unwrap().as_micros();
    let stamp = micros as f64 / 1e6;
    let first_ray = scan.first_ray_stamp().duration_since(UNIX_EPOCH).unwrap().as_micros();
    let first_ray = first_ray as f64 / 1e6;
    let expected = format!(
        "{{\"sequence\":0,\"stamp\":{stamp},\"first_ray\":{first_ray},\
         \"stamp_quality\":\"arrival\",\"lateness\":null,\"start\":382,\"end\":385,\"cluster\":1,\
         \"angle_min\":{},\"angle_increment\":{},\"scan_time\":0.1,\
         \"range_min\":0.019,\"range_max\":4.095,\"repeat\":false,\"reconnects\":0,\"beyond\":[0,4095],\"values\":[1234,0,7,4095],\
         \"ranges\":[1.234,null,null,null]}}",
        scan.angle_min(),
        scan.angle_increment(),
    );
    assert_eq!(text, expected);
    // To the microsecond, however many digits that takes.
    let read: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((read["stamp"].as_f64().unwrap() * 1e6).round() as u128, micros);
}

/// Values may have 18 bits, and the geometry has the fields that it had in SCIP 1.1.
#[test]
fn a_scan_of_another_model_has_the_same_shape() {
    let frame = "PP\n00P\nMODL:UST-10LX;D\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\nAMIN:0;?\n\
        AMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U";
    let request = scip2::Request::new(scip2::Command::Parameters, None);
    let reply = scip2::Reply::parse(&request, frame.as_bytes()).unwrap();
    let scip2::Content::Parameters(parameters) = reply.content else { panic!() };
    let geometry = parameters.geometry();
    let scan = Scan::builder(Window::degrees(-0.3..=0.3).unwrap(), [60_000, 65_533, 2]);
    let scan = scan.geometry(geometry).build().unwrap();
    let data = serde_json::to_value(&scan).unwrap();
    assert_eq!((&data["start"], &data["end"]), (&json!(539), &json!(541)));
    assert_eq!(data["values"], json!([60_000, 65_533, 2]));
    assert_eq!(data["ranges"], json!([60.0, null, null]));
    assert_eq!((&data["beyond"], &data["range_max"]), (&json!([65_533]), &json!(60.001_f32)));
    let measurements: Vec<Measurement> = scan.rays().map(|ray| ray.measurement).collect();
    let codes = json!([{"distance": 60_000}, {"error": 65_533}, {"error": 2}]);
    assert_eq!(serde_json::to_value(measurements).unwrap(), codes);
    assert_eq!(
        serde_json::to_value(scan.window()).unwrap(),
        json!({"start": 539, "end": 541, "cluster": 1})
    );
    let fields = json!({
        "steps_per_revolution": 1440, "first_step": 0, "last_step": 1080, "front_step": 540,
        "min_distance": 23, "max_distance": 60_000
    });
    assert_eq!(serde_json::to_value(geometry).unwrap(), fields);
}

#[test]
fn a_rate_and_an_endpoint_are_serialized_as_their_text() {
    for rate in [Rate::hz(10.0), Rate::hz(1.0 / 3.0), Rate::UNLIMITED] {
        let data = serde_json::to_value(rate).unwrap();
        assert_eq!(data, json!(rate.to_string()));
        assert_eq!(serde_json::from_value::<Rate>(data).unwrap(), rate);
    }
    let read = |value: Value| serde_json::from_value::<Rate>(value);
    assert_eq!(read(json!(10)).unwrap(), Rate::hz(10.0));
    assert_eq!(read(json!(0.5)).unwrap(), Rate::hz(0.5));
    for bad in [json!(0), json!(-1), json!(1001.0), json!("fast"), json!(null)] {
        assert!(read(bad.clone()).is_err(), "{bad}");
    }
    let error = read(json!(0)).unwrap_err().to_string();
    assert!(error.contains("invalid rate \"0\": expected more than 0"), "{error}");

    let endpoint: Endpoint = "tcp://bridge:4001?baud=57600".parse().unwrap();
    let data = serde_json::to_value(&endpoint).unwrap();
    assert_eq!(data, json!("tcp://bridge:4001?baud=57600"));
    assert_eq!(serde_json::from_value::<Endpoint>(data).unwrap(), endpoint);
    let error = serde_json::from_value::<Endpoint>(json!("tcp://bridge:")).unwrap_err();
    assert!(error.to_string().contains("invalid port \"tcp://bridge:\""), "{error}");
}

#[test]
fn a_window_is_deserialized_and_never_an_invalid_one() {
    let window = Window::DETECTION.with_cluster_count(4).unwrap();
    let data = serde_json::to_value(window).unwrap();
    assert_eq!(data, json!({"start": 44, "end": 725, "cluster": 4}));
    assert_eq!(serde_json::from_value::<Window>(data).unwrap(), window);
    let read = |value: Value| serde_json::from_value::<Window>(value);
    assert_eq!(read(json!({"start": 44, "end": 725})).unwrap(), Window::DETECTION);
    for bad in [
        json!({"start": 44, "end": 10_000}),
        json!({"start": 45, "end": 44}),
        json!({"start": 44, "end": 725, "cluster": 0}),
        json!({"start": 44}),
    ] {
        assert!(read(bad.clone()).is_err(), "{bad}");
    }
}

#[tokio::test(start_paused = true)]
async fn measurements_version_and_stats_are_data() {
    let all: Vec<Measurement> = scan().await.rays().map(|ray| ray.measurement).collect();
    let data = serde_json::to_value(&all).unwrap();
    assert_eq!(data, json!([{"distance": 1234}, {"error": 0}, {"error": 7}, "saturated"]));

    let (sensor, _) = sensor().await;
    let version = serde_json::to_value(sensor.version().await.unwrap()).unwrap();
    assert_eq!(version["serial_number"], "H0713090");
    assert_eq!(version["specification"]["motor_speed"], 600);

    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    scans.next().await.unwrap().unwrap();
    let stats = serde_json::to_value(sensor.stats()).unwrap();
    assert_eq!(stats["scans"], 1);
    let last = stats["reply_latency"]["last"].as_f64().unwrap();
    assert_eq!(last, sensor.stats().reply_latency.last.as_secs_f64());
    assert_eq!(stats["schedules"][0]["window"]["start"], 44);
}

#[test]
fn a_serialized_error_has_all_its_causes() {
    let refused = std::io::Error::new(std::io::ErrorKind::NotFound, "no such device");
    let error = Error::open("/dev/ttyACM0", refused);
    let data = serde_json::to_value(State::Closed { error: Some(error) }).unwrap();
    let text = data["error"].as_str().unwrap();
    assert!(text.ends_with(": no such device"), "{text}");
}

#[tokio::test(start_paused = true)]
async fn a_state_is_serialized_without_instants() {
    let data = |state: &State| serde_json::to_value(state).unwrap();
    let (sensor, emulator) = sensor().await;
    let fresh = |sensor: &Sensor| serde_json::to_value(sensor.freshness()).unwrap();
    assert_eq!(fresh(&sensor), json!({"age": null, "error": null}));
    sensor.scan(Window::DETECTION).await.unwrap();
    let connected = json!({
        "state": "connected", "baud_rate": null, "streaming": false, "serial_number": "H0713090"
    });
    assert_eq!(data(&sensor.watch_state().get()), connected);
    let mut state = sensor.watch_state();
    emulator.unplug();
    state.wait_for(|state| matches!(state, State::Disconnected { .. })).await.unwrap();
    tokio::time::sleep(Duration::from_secs(3)).await;
    let lost = data(&state.get());
    assert_eq!(lost["state"], "disconnected");
    assert!((2.9..3.1).contains(&lost["since"].as_f64().unwrap()), "{lost}");
    assert!(lost["error"].as_str().unwrap().contains("no port"), "{lost}");
    assert!((2.9..3.2).contains(&fresh(&sensor)["age"].as_f64().unwrap()));
    assert_eq!(fresh(&sensor)["error"], lost["error"]);
    sensor.close().await;
    assert_eq!(data(&sensor.watch_state().get()), json!({"state": "closed", "error": null}));
}
