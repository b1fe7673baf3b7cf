//! Arguments of `urg publish` that can never work: each is refused at once, with what was
//! expected.

use super::program::program;

/// Runs `urg publish emulated` with these arguments, which are wrong, and returns the error.
fn refused(arguments: &[&str]) -> String {
    let output = program("publish emulated").args(arguments).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    // The message names no place in a source file.
    for path in [".rs:", ".cargo", env!("CARGO_MANIFEST_DIR")] {
        assert!(!error.contains(path), "{arguments:?}: {error}");
    }
    error
}

#[test]
fn a_wrong_name_is_refused_with_what_was_expected() {
    let long = "n".repeat(300);
    for (arguments, expected) in [
        (["--frame", "/laser"], "without a leading `/`"),
        (["--frame", ""], "--frame"),
        (["--frame", "a\nb"], "control characters"),
        (["--frame", &long], "--frame"),
        (["--topic", "/a//b"], "`/a//b`: expected no empty part"),
        (["--topic", ""], "--topic: expected a name"),
        (["--topic", "/"], "--topic: expected a name"),
        (["--topic", "~/"], "--topic: expected a name"),
        (["--topic", "sc an"], "--topic: invalid name `sc an`"),
        (["--topic", &long], "too long: expected at most 240"),
        (["--namespace", "a//b"], "`a//b`: expected no empty part"),
        (["--namespace", "/a/"], "`/a/`: expected no empty part"),
        (["--namespace", &long], "too long: expected at most 240"),
        (["--node", "a-b"], "--node: invalid name `a-b`"),
        (["--node", ""], "--node: invalid name ``"),
        (["--node", &long], "too long: expected at most 240"),
        (["--domain", "-1"], "-1 is not in 0..=232"),
        (["--domain", "233"], "233 is not in 0..=232"),
        (["--tf", "base_link"], "PARENT,X,Y,Z,YAW in metres and degrees"),
        (["--tf", "a,0,0,0"], "PARENT,X,Y,Z,YAW"),
        (["--tf", "a,0,0,0,0,0"], "`,upside-down` or `,PITCH,ROLL` after it"),
        (["--tf", ",0,0,0,0"], "PARENT,X,Y,Z,YAW"),
        (["--tf", "/a,0,0,0,0"], "PARENT,X,Y,Z,YAW"),
        (["--tf", "a,NaN,0,0,0"], "PARENT,X,Y,Z,YAW"),
        (["--tf", "a,0,0,0,361"], "at most 1000 m and 360°"),
        (["--tf", "laser,0,0,0,0"], "the parent `laser` is the frame of the sensor itself"),
        (["--depth", "0"], "0 is not in 1..=1000"),
        (["--interface", "eth0"], "expected the address of an interface"),
    ] {
        let error = refused(&arguments);
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
    let error = refused(&["--tf", "a,0,0,0,0", "--tf", "a,0,0,0,0"]);
    assert!(error.contains("expected one for each of 1 sensors, found 2"), "{error}");
    let error = refused(&["emulated"]);
    assert!(error.contains("two sensors would publish on /scan: name each of them"), "{error}");
}

#[test]
fn a_router_that_can_never_work_is_refused() {
    for router in [
        "",
        "localhost:7447",
        "10.0.0.1",
        "udp/localhost:7447",
        "tcp/localhost",
        "tcp/localhost:99999",
        "tcp/localhost:",
        "tcp/localhost:0",
        "tcp/:7447",
        "tcp/a b:7447",
        "tcp/::1:7447",
        "tcp/[x]:7447",
    ] {
        let error = refused(&["--engine", "zenoh", "--router", router]);
        assert!(error.contains("expected tcp/HOST:PORT"), "{router}: {error}");
    }
    for router in
        ["tcp/localhost:7447", "tcp/10.0.0.1:1", "tcp/[::1]:7447", "tcp/a.b-c:7447#iface=eth0"]
    {
        let error = refused(&["--engine", "zenoh", "--router", router, "--depth", "0"]);
        assert!(error.contains("0 is not in 1..=1000"), "{router}: {error}");
    }
}

#[test]
fn an_option_of_another_engine_is_refused() {
    for (engine, option, value, others) in [
        ("dds", "--router", "tcp/localhost:7447", "zenoh"),
        ("dds", "--mode", "peer", "zenoh"),
        ("zenoh", "--listen", "127.0.0.1:8765", "foxglove"),
        ("foxglove", "--domain", "1", "dds and zenoh"),
        ("foxglove", "--interface", "127.0.0.1", "dds and zenoh"),
    ] {
        let error = refused(&["--engine", engine, option, value]);
        assert!(error.contains(&format!("{option} is for {others}")), "{error}");
    }
    let error = refused(&["--engine", "foxglove", "--listen", "localhost"]);
    assert!(error.contains("or an address and a port"), "{error}");
}

#[test]
fn an_argument_of_ros_is_checked_as_its_option_is() {
    for (arguments, expected) in [
        (&["-p", "depth:=0"][..], "0 is not in 1..=1000"),
        (&["-p", "frame_id:=/laser"], "without a leading `/`"),
        (&["-p", "window:=200..100"], "invalid value '200..100' for '--window"),
        (&["-p", "baud:=1"], "invalid value '1' for '--baud"),
        (&["-p", "protocol:=3"], "invalid value '3' for '--protocol"),
        (&["-p", "timeout:=0"], "invalid value '0' for '--timeout"),
        (&["-p", "depth"], "expected NAME:=VALUE, found `depth`"),
        (&["-p", "depth:="], "expected NAME:=VALUE, found `depth:=`"),
        (&["-p"], "expected NAME:=VALUE after -p"),
        (&["-p", "depth:='"], "`depth:='`: invalid YAML"),
        (&["-p", "depth:=[1]"], "expected one value for depth"),
        (&["-r", ":=x"], "expected FROM:=TO, found `:=x`"),
        (&["-p", "use_sim_time:=true"], "use_sim_time is not supported"),
        (&["-r", "__node:=a-b"], "invalid name `a-b`"),
        (&["--log-level"], "expected a value after --log-level"),
        (&["--params-file", "p.yaml"], "cannot use --params-file p.yaml: No such file"),
        // Ignored, and checked is what follows.
        (&["--log-level", "urg:=debug", "--disable-stdout-logs", "-p", "depth:=0"], "0 is not in"),
        (
            &["-p", "use_sim_time:=False", "-r", "/tf:=tf", "-p", "x:=1", "-p", "depth:=0"],
            "0 is not",
        ),
        (&["-p", "/other/urg_node:depth:=0", "-p", "frame_id:=/laser"], "without a leading `/`"),
        (&["--ros-args", "--", "--depth", "0"], "0 is not in 1..=1000"),
    ] {
        let error = refused(&[&["--ros-args"], arguments].concat());
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
}

#[test]
fn a_file_without_parameters_of_ros_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.yaml");
    let deep: String = (0..3_000).map(|depth| format!("{}a:\n", " ".repeat(depth))).collect();
    for (text, expected) in [
        (&*deep, "at most 50 levels"),
        ("", "it is empty"),
        ("a", "expected `NODE: {ros__parameters: {NAME: VALUE}}`"),
        ("a: b", "expected `NODE: {ros__parameters: {NAME: VALUE}}`"),
        ("a: {ros__parameters: 1}", "expected `NODE: {ros__parameters: {NAME: VALUE}}`"),
        ("[a]: {}", "expected `NODE: {ros__parameters: {NAME: VALUE}}`"),
        ("{a: b}: {}", "expected `NODE: {ros__parameters: {NAME: VALUE}}`"),
        ("a: [", "invalid YAML"),
        ("/**: {ros__parameters: {depth: [{a: 1}, 2]}}", "expected one value for depth"),
        ("/**: {ros__parameters: {depth: 5, depth: 0}}", "0 is not in 1..=1000"),
        ("/**: {ros__parameters: {other: [a: {}], depth: 0}}", "0 is not in 1..=1000"),
        ("/*: {ros__parameters: {depth: 0}}", "0 is not in 1..=1000"),
        ("urg_node: {ros__parameters: {depth: 0}}", "0 is not in 1..=1000"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = refused(&["--ros-args", "--params-file", path.to_str().unwrap()]);
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn an_environment_that_ros_2_does_not_know_is_refused() {
    let long = "x".repeat(300);
    for (name, value) in [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "subnet"),
        ("ROS_STATIC_PEERS", "10.0.0.1 10.0.0.2"),
        ("ROS_STATIC_PEERS", "<Peer/>"),
        ("ROS_STATIC_PEERS", "10.0.0.256"),
        ("ROS_STATIC_PEERS", "::1"),
        ("ROS_STATIC_PEERS", "10.0.0.1:7400"),
        ("ROS_STATIC_PEERS", &long),
        ("ROS_DOMAIN_ID", "233"),
        ("ROS_DOMAIN_ID", "one"),
    ] {
        let output = program("publish emulated").env(name, value).output().unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{name}={value}: {error}");
        assert!(error.contains(&format!("invalid {name}")), "{name}={value}: {error}");
    }
}

#[test]
fn what_urg_node2_has_besides_is_told() {
    let told = |parameter| {
        let parameters = ["--ros-args", "-p", parameter];
        let output = program("publish /dev/urg-absent").args(parameters).output().unwrap();
        String::from_utf8(output.stderr).unwrap().contains("there is no life cycle")
    };
    assert!(told("angle_min:=-3.14"));
    assert!(!told("frame_id:=laser"));
}
