//! Whole replies: those in the protocol text, and error replies.

use tokio_scip::protocol::{
    BaudRate, Command, MalformedError, Reply, ReplyError, Status, Text, Window,
};

use super::encoder::{frame, lines, reply, spread};

fn window(start: u16, end: u16, cluster_count: u8) -> Window {
    Window::new(start..=end).unwrap().with_cluster_count(cluster_count).unwrap()
}

fn values(reply: &Reply) -> Vec<u16> {
    reply.values().to_vec()
}

#[test]
fn commands_have_the_bytes_of_the_text() {
    let bytes = |command: Command| command.bytes().to_vec();
    assert_eq!(bytes(Command::Version), b"V");
    assert_eq!(bytes(Command::LaserOn), b"L1");
    assert_eq!(bytes(Command::LaserOff), b"L0");
    // Six digits of baud rate and the seven reserved ones.
    assert_eq!(bytes(Command::BaudRate(BaudRate::B19200)), b"S0192000000000");
    assert_eq!(bytes(Command::BaudRate(BaudRate::B57600)), b"S0576000000000");
    assert_eq!(bytes(Command::BaudRate(BaudRate::B115200)), b"S1152000000000");
    assert_eq!(bytes(Command::BaudRate(BaudRate::B750000)), b"S7500000000000");
    // "000", "768" and "01" are the text's examples of G's parameters.
    assert_eq!(bytes(Command::Distances(Window::FULL)), b"G00076801");
    assert_eq!(bytes(Command::Distances(Window::DETECTION)), b"G04472501");
    assert_eq!(bytes(Command::Distances(window(7, 42, 99))), b"G00704299");
    assert_eq!(Command::Distances(Window::FULL).to_string(), "G00076801");
}

/// The text prints the characters of 1234 as `('C', 'D')`; that is a misprint:
/// its own numbers, 43 and 42 (hexadecimal), are `C` and `B`.
#[test]
fn the_value_of_the_text_is_1234_millimetres() {
    let command = Command::Distances(window(384, 384, 1));
    let frame = [b"G38438401\n0\n", &[0x43, 0x42][..]].concat();
    let reply = Reply::parse(&command, &frame).unwrap();
    assert!(reply.status.is_ok());
    assert_eq!(values(&reply), [1234]);
    assert_eq!(values(&Reply::parse(&command, b"G38438401\n0\nCD").unwrap()), [1236]);
}

#[test]
fn a_reply_to_another_command_than_g_has_no_values() {
    for (command, frame) in [
        (Command::Version, &b"V\n0\nVEND:Hokuyo Automatic Co.,Ltd.\nSERI:H0713090"[..]),
        (Command::LaserOff, b"L0\n0"),
        (Command::Distances(window(384, 384, 1)), b"G38438401\n6"),
    ] {
        assert_eq!(values(&Reply::parse(&command, frame).unwrap()), [0; 0], "{command}");
    }
}

#[test]
fn every_value_of_twelve_bits_is_decoded() {
    for first in (0..4096).step_by(512) {
        let sent: Vec<u16> = (first..first + 512).collect();
        let frame = frame("G00051101", &sent);
        assert_eq!(
            values(&Reply::parse(&Command::Distances(window(0, 511, 1)), &frame).unwrap()),
            sent
        );
    }
}

#[test]
fn data_around_whole_lines_is_cut_after_64_bytes() {
    for (points, echo, cut) in [
        (31, "G00003001", vec![62]),
        (32, "G00003101", vec![64]),
        (33, "G00003201", vec![64, 2]),
        (64, "G00006301", vec![64, 64]),
    ] {
        let sent = spread(points);
        let frame = frame(echo, &sent);
        let command = Command::Distances(window(0, points as u16 - 1, 1));
        assert_eq!(&*command.bytes(), echo.as_bytes());
        let reply = Reply::parse(&command, &frame).unwrap();
        let lines = frame.split(|byte| *byte == b'\n').skip(2);
        assert_eq!(lines.map(<[u8]>::len).collect::<Vec<_>>(), cut, "{points} points");
        assert_eq!(values(&reply), sent);
    }
}

#[test]
fn a_line_cut_anywhere_else_is_malformed() {
    let command = Command::Distances(window(0, 32, 1));
    let data = &frame("G00003201", &spread(33))[12..];
    let data: Vec<u8> = data.iter().copied().filter(|&byte| byte != b'\n').collect();
    for at in (1..data.len()).filter(|&at| at != 64) {
        let frame = [b"G00003201\n0\n", &data[..at], b"\n", &data[at..]].concat();
        let error = Reply::parse(&command, &frame).unwrap_err();
        let ReplyError::Malformed(MalformedError::LineLength { line, expected, found }) = error
        else {
            panic!("cut at {at}: {error:?}");
        };
        assert_eq!((line, expected, found), (0, 64, at));
    }
    let longer = [&frame("G00003101", &spread(32))[..], b"\n"].concat();
    assert_eq!(
        Reply::parse(&Command::Distances(window(0, 31, 1)), &longer),
        Err(MalformedError::LineLength { line: 1, expected: 0, found: 0 }.into())
    );
    let uncut = [b"G00003201\n0\n", &data[..]].concat();
    assert_eq!(
        Reply::parse(&command, &uncut),
        Err(MalformedError::LineLength { line: 0, expected: 64, found: 66 }.into())
    );
}

#[test]
fn a_full_scan_is_1576_bytes_and_the_detection_window_1399() {
    for (window, echo, points, data_lines, bytes) in [
        (Window::FULL, "G00076801", 769, 25, 1576),
        (Window::DETECTION, "G04472501", 682, 22, 1399),
    ] {
        let sent = spread(points);
        let reply = reply(echo, &sent);
        assert_eq!(reply.len(), bytes);
        assert_eq!(window.points(), points);
        let command = Command::Distances(window);
        let parsed = Reply::parse(&command, &reply[..bytes - 2]).unwrap();
        assert_eq!(reply.split(|byte| *byte == b'\n').count(), 2 + data_lines + 2);
        assert_eq!(values(&parsed), sent);
    }
}

#[test]
fn d10_a_partial_last_cluster_is_a_point() {
    for (start, end, cluster_count, points) in [
        (44, 725, 2, 341),
        (44, 725, 4, 171),
        (0, 768, 2, 385),
        (0, 768, 99, 8),
        (5, 5, 99, 1),
        (0, 98, 99, 1),
        (0, 99, 99, 2),
    ] {
        let window = window(start, end, cluster_count);
        let command = Command::Distances(window);
        let echo = format!("G{start:03}{end:03}{cluster_count:02}");
        assert_eq!(window.points(), points);
        let parse = |count| {
            Reply::parse(&command, &frame(&echo, &spread(count))).map(|reply| values(&reply).len())
        };
        assert_eq!(parse(points), Ok(points));
        for other in [points - 1, points + 1] {
            assert!(
                matches!(parse(other), Err(ReplyError::Malformed(_))),
                "{other} points for {window}"
            );
        }
    }
}

#[test]
fn d07_an_error_reply_is_echo_and_status_for_every_status() {
    for command in [
        Command::Version,
        Command::LaserOn,
        Command::LaserOff,
        Command::BaudRate(BaudRate::B250000),
        Command::Distances(Window::FULL),
    ] {
        for status in (b'!'..=b'~').filter(|&status| status != b'0') {
            let frame = [&command.bytes()[..], b"\n", &[status]].concat();
            let reply = Reply::parse(&command, &frame).unwrap();
            assert_eq!(char::from(reply.status), char::from(status));
            assert!(!reply.status.is_ok());
            assert_eq!(values(&reply), [0; 0]);
        }
    }
}

/// Status of a refusal with this character.
fn status(character: u8) -> Status {
    Reply::parse(&Command::LaserOn, &[b'L', b'1', b'\n', character]).unwrap().status
}

#[test]
fn only_version_and_distances_have_data() {
    let parse =
        |command: Command, frame: &[u8]| Reply::parse(&command, frame).map(|reply| reply.status);
    let success = status(b'0');
    let speed = Command::BaudRate(BaudRate::B57600);
    assert_eq!(parse(Command::LaserOn, b"L1\n0"), Ok(success));
    assert_eq!(parse(Command::LaserOff, b"L0\n0"), Ok(success));
    assert_eq!(parse(speed, b"S0576000000000\n0"), Ok(success));
    let unexpected = |bytes| Err(MalformedError::UnexpectedData { status: success, bytes }.into());
    assert_eq!(parse(Command::LaserOn, b"L1\n0\n00"), unexpected(2));
    assert_eq!(parse(speed, b"S0576000000000\n0\n"), unexpected(0));
    assert_eq!(parse(Command::Version, b"V\n0"), Err(MalformedError::NoData.into()));
    assert_eq!(parse(Command::Version, b"V\n0\n"), Err(MalformedError::NoData.into()));
    assert_eq!(
        parse(Command::Distances(Window::FULL), b"G00076801\n0"),
        Err(MalformedError::NoData.into())
    );
}

#[test]
fn a_status_is_one_printable_character() {
    let parse = |frame: &[u8]| Reply::parse(&Command::LaserOn, frame).unwrap_err();
    let status = |found: &[u8]| ReplyError::from(MalformedError::Status { found: found.into() });
    assert_eq!(parse(b"L1"), MalformedError::NoStatus.into());
    for line in [&b""[..], b"00", b"0\r", b" ", b"\r", b"\0", b"\x7f", b"\xb6", b"\xff", b"0000"] {
        assert_eq!(parse(&[b"L1\n", line].concat()), status(line));
    }
}

#[test]
fn another_echo_is_foreign_and_shown_shortened() {
    let command = Command::Distances(Window::DETECTION);
    for frame in [
        &b""[..],
        b"\n0",
        b"G04472502\n0",
        b"G0447250\n0",
        b"G044725011\n0",
        b"g04472501\n0",
        b"V\n0",
        b"G04472501\r\n0",
    ] {
        assert!(
            matches!(Reply::parse(&command, frame), Err(ReplyError::Foreign { .. })),
            "{frame:?}"
        );
    }
    let long = [b'x'; 4096];
    let Err(ReplyError::Foreign { found }) = Reply::parse(&command, &long) else { panic!() };
    assert_eq!(found, Text::from(&[b'x'; 32][..]));
}

#[test]
fn an_error_names_place_expectation_and_finding() {
    let command = Command::Distances(Window::FULL);
    let mut damaged = frame("G00076801", &spread(769));
    damaged[12 + 2 * 65 + 5] = 0xff;
    let error = Reply::parse(&command, &damaged).unwrap_err();
    assert_eq!(error, MalformedError::Character { line: 2, column: 5, found: 0xff }.into());
    assert_eq!(
        error.to_string(),
        "expected 0x30 to 0x6f as character 5 of data line 2, found 0xff"
    );
    let whole = frame("G00076801", &spread(769));
    assert_eq!(
        Reply::parse(&command, &whole[..whole.len() - 3]),
        Err(MalformedError::Short { expected: 1538, found: 1536 }.into())
    );
    assert_eq!(
        Reply::parse(&command, &whole[..whole.len() - 1]).unwrap_err().to_string(),
        "expected 2 characters in line 24 of the data, found 1"
    );
}

#[test]
fn w24_a_status_with_its_checksum_is_scip_2() {
    let scip2 = |status: &str| Err(ReplyError::Scip2 { status: status.into() });
    let parse = |frame: &'static [u8]| Reply::parse(&Command::Version, frame);
    assert_eq!(parse(b"V\n0Eu"), scip2("0Eu"));
    assert_eq!(parse(b"V\n0Ee"), scip2("0Ee"));
    assert_eq!(parse(b"V\n00P\nVEND:Hokuyo;x"), scip2("00P"));
    // Sent without a request by a sensor that streams with MD.
    assert_eq!(parse(b"MD0044072501000\n99b\n0ABCD\n"), scip2("99b"));
    assert!(matches!(parse(b"MD0044072501000\n0"), Err(ReplyError::Foreign { .. })));
    assert!(matches!(parse(b"L1\n00P"), Err(ReplyError::Foreign { .. })));
    // A status of three characters that no SCIP 2 sensor sends is damage.
    for damage in [&b"V\n0Ex"[..], b"V\n\x01\x02\x03", b"V\n0\x450", b"V\n\xff0/", b"V\n0\xff/"] {
        assert!(matches!(parse(damage), Err(ReplyError::Malformed(MalformedError::Status { .. }))));
    }
}

#[test]
fn w05_a_one_step_reply_is_not_scip_2() {
    let command = Command::Distances(window(384, 384, 1));
    assert_eq!(
        Reply::parse(&command, b"G38438401\n0CD"),
        Err(MalformedError::Status { found: "0CD".into() }.into())
    );
}

#[test]
fn the_encoder_of_these_tests_is_that_of_the_text() {
    assert_eq!(super::encoder::characters(1234), [0x43, 0x42]);
    assert_eq!(super::encoder::characters(0), *b"00");
    assert_eq!(super::encoder::characters(4095), *b"oo");
    assert_eq!(lines(&[b'0'; 66]), [&[b'0'; 64][..], b"\n00"].concat());
}
