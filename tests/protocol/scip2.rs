//! SCIP 2: bytes written by hand from the protocol text C-42-03320B and from replies of real
//! sensors. Serial numbers are invented.

use tokio_scip::protocol::scip2::{
    Command, Content, Data, Label, MotorSpeed, Reply, Request, Stamp, Status, Stream,
};
use tokio_scip::protocol::{BaudRate, ReplyError, Version, Window};

fn window(first: u16, last: u16) -> Window {
    Window::new(first..=last).unwrap()
}

fn latest(data: Data, first: u16, last: u16) -> Request {
    Request::new(Command::Latest { data, window: window(first, last) }, None)
}

fn parse(command: Command, frame: &str) -> Result<Content, ReplyError> {
    Reply::parse(&Request::new(command, None), frame.as_bytes()).map(|reply| reply.content)
}

fn error(request: &Request, frame: &str) -> String {
    Reply::parse(request, frame.as_bytes()).unwrap_err().to_string()
}

#[test]
fn commands_have_the_bytes_of_the_text() {
    let all = Stream::new(Data::Distances, window(0, 1080));
    let some = Stream::new(Data::Intensities, window(44, 725).with_cluster_count(3).unwrap())
        .skipping(2)
        .unwrap()
        .ending_after(7)
        .unwrap();
    for (command, bytes) in [
        (Command::Version, "VV"),
        (Command::Parameters, "PP"),
        (Command::State, "II"),
        (Command::StateCode, "%ST"),
        (Command::Sleep, "%SL"),
        (Command::LaserOn, "BM"),
        (Command::LaserOff, "QT"),
        (Command::Reset, "RS"),
        (Command::ResetClock, "RT"),
        (Command::Reboot, "RB"),
        (Command::BaudRate(BaudRate::B19200), "SS019200"),
        (Command::BaudRate(BaudRate::B750000), "SS750000"),
        (Command::MotorSpeed(MotorSpeed::new(3).unwrap()), "CR03"),
        (Command::MotorSpeed(MotorSpeed::new(99).unwrap()), "CR99"),
        (Command::EnterClockMode, "TM0"),
        (Command::Clock, "TM1"),
        (Command::ClockInMicroseconds, "%TM1"),
        (Command::LeaveClockMode, "TM2"),
        (Command::Latest { data: Data::Distances, window: window(44, 725) }, "GD0044072501"),
        (Command::Latest { data: Data::ShortDistances, window: window(0, 768) }, "GS0000076801"),
        (Command::Latest { data: Data::Intensities, window: window(0, 9999) }, "GE0000999901"),
        (Command::Stream(all), "MD0000108001000"),
        (Command::Stream(all.in_microseconds()), "%MD0000108001000"),
        (Command::Stream(some), "ME0044072503207"),
        (Command::Stream(some.in_microseconds()), "%ME0044072503207"),
        (Command::Stream(Stream::new(Data::ShortDistances, window(5, 5))), "MS0005000501000"),
    ] {
        assert_eq!(Request::new(command, None).bytes(), bytes.as_bytes());
        let label = Label::new("host 1._+@").unwrap();
        let labelled = format!("{bytes};host 1._+@");
        assert_eq!(Request::new(command, label).bytes(), labelled.as_bytes());
    }
}

#[test]
fn reply_lengths_are_those_of_real_sensors() {
    let stream_to = |end, data| {
        Request::new(Command::Stream(Stream::new(data, window(0, end))), None).reply_len()
    };
    assert_eq!(latest(Data::Distances, 44, 725).reply_len(), Some(2134));
    assert_eq!(stream_to(1080, Data::Distances), Some(3372));
    assert_eq!(stream_to(1080, Data::Intensities), Some(6717));
    // A UST-10LX-H01, by C-42-04213 p. 2.
    assert_eq!(stream_to(2160, Data::Intensities), Some(13_399));
    assert_eq!(Request::new(Command::LaserOn, None).reply_len(), Some("BM\n00P\n\n".len()));
    let clock = Request::new(Command::Clock, Label::new("a").unwrap());
    assert_eq!(clock.reply_len(), Some("TM1;a\n00P\nm2@0?\n\n".len()));
    assert_eq!(Request::new(Command::Parameters, None).reply_len(), None);
}

#[test]
fn numbers_out_of_range_make_no_command() {
    for (error, text) in [
        (
            Stream::new(Data::Distances, window(0, 1)).skipping(10).unwrap_err(),
            "invalid number of skipped scans \"10\": expected 0 to 9",
        ),
        (
            Stream::new(Data::Distances, window(0, 1)).ending_after(0).unwrap_err(),
            "invalid number of scans \"0\": expected 1 to 99",
        ),
        (MotorSpeed::new(11).unwrap_err(), "invalid motor speed \"11\": expected 0 to 10, or 99"),
    ] {
        assert_eq!(error.to_string(), text);
    }
    for text in ["", "seventeen letters", "semi;colon", "line\n", "ä"] {
        assert!(Label::new(text).is_err(), "{text}");
    }
}

/// 1234 mm in two characters, 5432 mm in three and 16,000,000 ms in four are the text's (p. 6 to 8).
#[test]
fn numbers_of_the_text_are_decoded() {
    let short = latest(Data::ShortDistances, 0, 0);
    let Content::Scan(scan) =
        Reply::parse(&short, b"GS0000000001\n00P\nm2@0?\nCB5").unwrap().content
    else {
        panic!()
    };
    assert_eq!(scan.distances(), [1234]);
    assert_eq!(scan.stamp, Stamp::Milliseconds(16_000_000));
    let Content::Scan(scan) =
        Reply::parse(&latest(Data::Distances, 0, 0), b"GD0000000001\n00P\nm2@0?\n1DhM")
            .unwrap()
            .content
    else {
        panic!()
    };
    assert_eq!(scan.distances(), [5432]);
    assert_eq!(scan.intensities(), [0; 0]);
}

#[test]
fn a_value_may_run_over_the_end_of_a_line() {
    let frame = "GD0000002101\n00P\n01_2b\n\
        0070?_0OG0^o0nW1>?1Mg1]O1m72<_2LG2[o2kW3;?3Jg3ZO3j749_4IG4Xo4hW5H\n8?g";
    let Content::Scan(scan) =
        Reply::parse(&latest(Data::Distances, 0, 21), frame.as_bytes()).unwrap().content
    else {
        panic!()
    };
    let expected: Vec<u32> = (0..22).map(|index| 1000 * index + 7).collect();
    assert_eq!(scan.distances(), expected);
}

#[test]
fn a_stream_counts_down() {
    let stream = Stream::new(Data::Intensities, window(5, 5)).ending_after(9).unwrap();
    let command = Command::Stream(stream.in_microseconds());
    let content = parse(command, "%ME0005000501009\n00P").unwrap();
    assert_eq!(content, Content::Nothing);
    let scan = "%ME0005000501004\n99b\n0062R@H8290e\nA5`0GLI";
    let Content::Scan(scan) = parse(command, scan).unwrap() else { panic!() };
    assert_eq!((scan.distances(), scan.intensities()), (&[70_000][..], &[1500][..]));
    assert_eq!(scan.stamp, Stamp::Microseconds(1_700_000_000_123_456));
    assert_eq!(scan.stamp.since_zero().as_secs(), 1_700_000_000);
    assert_eq!(scan.left, 4);
    // More scans left than were asked for.
    let more = "%ME0005000501010\n99b\n0062R@H8290e\nA5`0GLI";
    assert!(matches!(parse(command, more), Err(ReplyError::Foreign { .. })));
}

#[test]
fn a_time_above_64_bits_is_refused() {
    let reply = |time: &str, sum: char| format!("%TM1\n00P\n{time}{sum}");
    let clock = |reply: &str| parse(Command::ClockInMicroseconds, reply);
    let most = Content::Clock(Stamp::Microseconds(u64::MAX));
    assert_eq!(clock(&reply("?oooooooooo", 'E')).unwrap(), most);
    let error = clock(&reply("@oooooooooo", 'F')).unwrap_err().to_string();
    assert_eq!(error, "expected a time below 2^64 in line 0, found \"@oooooooooo\"");
}

const VERSION: &str = "VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX;[\n\
    FIRM:3.1.04(02/Aug./2007);a\nPROT:SCIP 2.0;N\nSERI:H0000001;6";

fn version(frame: &str) -> Result<Version, ReplyError> {
    match parse(Command::Version, frame)? {
        Content::Version(version) => Ok(version),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_version_has_its_fields() {
    let version = version(VERSION).unwrap();
    assert_eq!(version.vendor, "Hokuyo Automatic Co.,Ltd.");
    assert_eq!(version.product, "SOKUIKI Sensor URG-04LX");
    assert_eq!(version.firmware, "3.1.04(02/Aug./2007)");
    assert_eq!(version.protocol, "SCIP 2.0");
    assert_eq!(version.serial_number, "H0000001");
}

#[test]
fn a_sum_may_be_a_semicolon() {
    // A UST writes its vendor with a blank.
    let frame = VERSION.replace("Co.,Ltd.;[", "Co., Ltd.;;").replace("H0000001;6", "H0000006;;");
    let version = version(&frame).unwrap();
    assert_eq!(version.vendor, "Hokuyo Automatic Co., Ltd.");
    assert_eq!(version.serial_number, "H0000006");
}

/// Reported of a URG-04LX (ros-drivers/urg_c, pull request 4).
#[test]
fn a_serial_number_may_have_its_sum_apart() {
    for end in [";\n6", ";\nI", ";x\nI"] {
        let frame = VERSION.replace(";6", end);
        assert_eq!(version(&frame).unwrap().serial_number, "H0000001", "{frame}");
    }
    // Without the line that is too much, the sum counts.
    let error = version(&VERSION.replace(";6", ";7")).unwrap_err().to_string();
    assert_eq!(error, "expected the sum 0x36 in line 4, found 0x37");
    // So it does in any other line.
    assert!(version(&VERSION.replace(";N", ";\nN")).is_err());
}

#[test]
fn parameters_have_their_numbers() {
    let frame = "PP\n00P\nMODL:UST-10LX;D\nDMIN:20;4\nDMAX:30000;G\nPROT:SCIP 2.2;P\nARES:1440;^\n\
        AMIN:0;?\nAMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U";
    let Content::Parameters(found) = parse(Command::Parameters, frame).unwrap() else { panic!() };
    assert_eq!(found.model, "UST-10LX");
    assert_eq!(found.distances, 20..=30_000);
    assert_eq!(found.steps_per_revolution, 1440);
    assert_eq!(found.steps, 0..=1080);
    assert_eq!((found.front, found.motor_speed), (540, 2400));
    assert_eq!(found.other, [("PROT".into(), "SCIP 2.2".into())]);
    for (from, to, error) in [
        ("\nSCAN:2400;U", "", "expected SCAN:1..=65535 in the reply, found \"\""),
        ("AMIN:0;?", "AMIN:1081;Y", "expected AMAX:1081..=9999 in the reply, found \"1080\""),
        ("AMAX:1080;Z", "AMAX:108x;b", "expected AMAX:0..=9999 in the reply, found \"108x\""),
        (
            "AFRT:540;0",
            "AFRT:540:0",
            "expected key:value; and a sum in line 7, found \"AFRT:540:0\"",
        ),
        (
            "ARES:1440;^",
            "ARES 1440;D",
            "expected key:value; and a sum in line 4, found \"ARES 1440;D\"",
        ),
    ] {
        assert!(frame.contains(from));
        let found = parse(Command::Parameters, &frame.replace(from, to)).unwrap_err();
        assert_eq!(found.to_string(), error);
    }
}

#[test]
fn a_state_has_its_words_and_its_clock() {
    let frame = "II\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nLASR:OFF;7\n\
        SCSP:Initial(600[rpm])<-Default setting by user;A\nMESM:IDLE;:\n\
        SBPS:19200[bps]<-Default setting by user;A\nTIME:001957;O\nSTAT:Sensor works well.;8";
    let state = |frame: &str| match parse(Command::State, frame).unwrap() {
        Content::State(state) => state,
        other => panic!("{other:?}"),
    };
    let found = state(frame);
    assert_eq!(found.laser_on, Some(false));
    assert_eq!(found.measuring, "IDLE");
    assert_eq!(found.clock, Some(0x1957));
    assert_eq!(found.diagnosis, "Sensor works well.");
    // The sum of a UTM-30LX may end before "<-".
    assert_eq!(state(&frame.replace("user;A\nMESM", "user;[\nMESM")), found);
    // A UST sends the time in four characters. One may be a semicolon.
    assert_eq!(state(&frame.replace("TIME:001957;O", "TIME:01`U;o")).clock, Some(7205));
    assert_eq!(state(&frame.replace("TIME:001957;O", "TIME:01:;;o")).clock, Some(4747));
    assert_eq!(state(&frame.replace("LASR:OFF;7", "LASR:ON;9")).laser_on, Some(true));
}

#[test]
fn a_state_may_be_a_number() {
    let content = parse(Command::StateCode, "%ST\n00P\n003C").unwrap();
    assert_eq!(content, Content::StateCode(*b"003"));
}

#[test]
fn a_status_has_a_meaning_for_its_command() {
    let status = |command: Command, line: &str| -> Status {
        let request = Request::new(command, None);
        let frame = [request.bytes(), b"\n", line.as_bytes()].concat();
        Reply::parse(&request, &frame).unwrap().status
    };
    let scan = Command::Latest { data: Data::Distances, window: window(0, 1) };
    let stream = Command::Stream(Stream::new(Data::Distances, window(0, 1)));
    for (command, line, is_ok, is_ok_for, meaning) in [
        (Command::LaserOn, "00P", true, true, Some("success")),
        (Command::LaserOn, "02R", false, true, Some("the laser is on already")),
        (
            Command::LaserOn,
            "01Q",
            false,
            false,
            Some("the laser is out of order, or the sensor not stable yet"),
        ),
        (Command::Reboot, "01Q", false, true, Some("send it once more within a second")),
        (Command::Version, "0Ee", false, false, Some("the sensor does not know the command")),
        (scan, "10Q", false, false, Some("the laser is off")),
        (
            Command::LaserOn,
            "10Q",
            false,
            false,
            Some("the sensor's state does not allow the command"),
        ),
        (
            stream,
            "0Ll",
            false,
            false,
            Some("the sensor is in an abnormal state: reboot or power-cycle it"),
        ),
        (stream, "21S", false, false, Some("the sensor stopped to check an error")),
        (stream, "50U", false, false, Some("laser, motor or other hardware is out of order")),
        (stream, "98a", false, false, Some("the sensor resumes, with its laser in order again")),
        (stream, "20R", false, false, None),
        (Command::LaserOff, "04T", false, false, None),
    ] {
        let status = status(command, line);
        assert_eq!(status.to_string(), line[..2]);
        assert_eq!((status.is_ok(), status.is_ok_for(&command)), (is_ok, is_ok_for), "{line}");
        assert_eq!(status.meaning(&command), meaning, "{line}");
    }
}

#[test]
fn an_error_names_line_and_cause() {
    let request = latest(Data::Distances, 0, 1);
    for (frame, text) in [
        (
            "GD0000000101",
            "expected a status of two characters and their sum in the reply, found \"\"",
        ),
        (
            "GD0000000101\n00Q",
            "expected a status of two characters and their sum in the reply, found \"00Q\"",
        ),
        ("GD0000000101\n00P", "expected data in line 0, found the end"),
        ("GD0000000101\n00P\n01_2b", "expected data in line 1, found the end"),
        ("GD0000000101\n10Q\n01_2b", "expected the end in line 0, found \"01_2b\""),
        ("GD0000000101\n00P\n01_b", "expected 5 bytes in line 0, found 4 bytes"),
        ("GD0000000101\n00P\n01_2c", "expected the sum 0x62 in line 0, found 0x63"),
        ("GD0000000101\n00P\n01_2b\n0CB>o0", "expected 7 bytes in line 1, found 6 bytes"),
        (
            "GD0000000101\n00P\n01_2b\n0CB&oo0",
            "expected characters from '0' to 'o' in line 1, found \"&oo\"",
        ),
        ("GD0000000101\n00P\n01_2b\n0CB>oo1", "expected the sum 0x41 in line 1, found 0x31"),
        ("GD0000000101\n00P\n01_2b\n0CB>ooA\n0", "expected none in line 2, found 1 bytes"),
        ("GD0000000100\n00P", "expected the echo of the command, found \"GD0000000100\""),
    ] {
        assert_eq!(error(&request, frame), text, "{frame}");
    }
}

#[test]
fn other_protocols_are_refused_with_a_sentence() {
    let request = latest(Data::Distances, 0, 1);
    for (frame, text) in [
        (
            "GD0000000101\n0",
            "expected SCIP 2, found the status \"0\" of SCIP 1.1: send SCIP2.0 to a URG-04LX",
        ),
        (
            "ND0000108000000\n99b\n01_2b",
            "expected one echo a step, found \"ND0000108000000\", which asks for several: stop it with QT",
        ),
        (
            "\u{2}00EEAR00A012\u{3}",
            "expected SCIP 2, found a frame of the UAM safety scanners' own protocol: send MD",
        ),
    ] {
        assert_eq!(error(&request, frame), text);
    }
}

#[test]
fn two_labels_differ_in_two_characters() {
    let numbers = (0..200).map(|n| (u64::MAX - 5).wrapping_add(n));
    let labels: Vec<String> = numbers.map(|n| Label::numbered(n).to_string()).collect();
    for (index, one) in labels.iter().enumerate() {
        assert!(Label::new(one).is_ok());
        for other in &labels[..index] {
            let pairs = one.bytes().zip(other.bytes());
            assert!(pairs.filter(|(a, b)| a != b).count() >= 2, "{one} {other}");
        }
    }
}

#[test]
fn a_reply_to_another_label_is_foreign() {
    let [old, new] = [7, 8].map(|n| Request::new(Command::LaserOn, Label::numbered(n)));
    let frame = [old.bytes(), b"\n00P"].concat();
    assert!(Reply::parse(&old, &frame).is_ok());
    assert!(matches!(Reply::parse(&new, &frame), Err(ReplyError::Foreign { .. })));
    let unlabelled = Request::new(Command::LaserOn, None);
    assert!(matches!(Reply::parse(&unlabelled, &frame), Err(ReplyError::Foreign { .. })));
}

/// What a sum cannot see, as the documentation says.
#[test]
fn two_neighbours_swapped_pass() {
    let request = latest(Data::Distances, 0, 1);
    for data in ["0CB>ooA", "C0B>ooA"] {
        let frame = format!("GD0000000101\n00P\n01_2b\n{data}");
        assert!(Reply::parse(&request, frame.as_bytes()).is_ok());
    }
}

/// The sum does not see bit 6, so `0` may have become `p`.
#[test]
fn a_status_is_digits_and_capitals() {
    for line in ["p0P", "0pP", "0%E", "0 P"] {
        let reply = parse(Command::LaserOn, &format!("BM\n{line}"));
        assert!(matches!(reply, Err(ReplyError::Malformed(_))), "{line}");
    }
}
