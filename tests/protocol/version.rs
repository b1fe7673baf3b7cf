//! The identity of a sensor: its reply to `V`.

use tokio_scip::protocol::{Command, Reply, Specification, Text, Version};

/// Example in the text (p. 4).
const OF_THE_TEXT: &[u8] = b"V\n\
0\n\
VEND: Hokuyo Automatic Co., Ltd.\n\
PROD: SOKUIKI Sensor URG-X002\n\
FIRM: 0.01.22a,(2004/12/27)\n\
PROT: 00001,(SCIP 1.0)\n\
SERI: H0400000\n\n";

/// A real URG-04LX with firmware 3.3.
const OF_FIRMWARE_3: &[u8] = b"V\n\
0\n\
VEND:Hokuyo Automatic Co.,Ltd.\n\
PROD:SOKUIKI Sensor URG-04LX\n\
FIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])\n\
PROT:00003,(SCIP 1.0)\n\
SERI:H0713090\n\
STAT:FW Normal[FinalDist with shadow  ]\n\n";

fn version(reply: &[u8]) -> Version {
    let frame = reply.strip_suffix(b"\n\n").unwrap_or(reply);
    Version::from_reply(&Reply::parse(&Command::Version, frame).unwrap())
}

#[test]
fn the_reply_of_the_text_is_read() {
    let version = version(OF_THE_TEXT);
    assert_eq!(version.vendor, "Hokuyo Automatic Co., Ltd.");
    assert_eq!(version.product, "SOKUIKI Sensor URG-X002");
    assert_eq!(version.firmware, "0.01.22a,(2004/12/27)");
    assert_eq!(version.protocol, "00001,(SCIP 1.0)");
    assert_eq!(version.serial_number, "H0400000");
    assert_eq!(version.status, None);
    assert_eq!(version.specification, None);
    assert!(version.other.is_empty());
}

#[test]
fn d11_replies_of_firmware_3_are_read() {
    assert_eq!(OF_FIRMWARE_3.len(), 206);
    let firm = OF_FIRMWARE_3.split(|&byte| byte == b'\n').nth(4).unwrap();
    assert_eq!(firm.len(), 64);
    let version = version(OF_FIRMWARE_3);
    assert_eq!(version.vendor, "Hokuyo Automatic Co.,Ltd.");
    assert_eq!(version.serial_number, "H0713090");
    assert_eq!(version.status, Some("FW Normal[FinalDist with shadow  ]".into()));
    let specification = version.specification.unwrap();
    assert_eq!(specification.range, Some(20..=4095));
    assert_eq!(specification.aperture, Some(240));
    assert_eq!(specification.steps, Some(44..=725));
    assert_eq!(specification.motor_speed, Some(600));
}

#[test]
fn d11_lines_may_come_in_any_order_be_missing_or_be_unknown() {
    let version = version(b"V\n0\nSERI:H1\nNEWS: of 2030 \nno colon\nPROD:URG");
    assert_eq!(version.serial_number, "H1");
    assert_eq!(version.product, "URG");
    assert_eq!(version.vendor, "");
    assert_eq!(version.other, [Text::from("NEWS: of 2030 "), Text::from("no colon")]);
}

#[test]
fn w23_escapes_for_a_terminal_are_shown_escaped() {
    let version = version(b"V\n0\nVEND:\x1b[2J\x00\xff\\\rfake\x7f\xc3\xa9");
    assert_eq!(version.vendor.as_bytes(), b"\x1b[2J\x00\xff\\\rfake\x7f\xc3\xa9");
    assert_eq!(version.vendor.to_string(), r"\x1b[2J\x00\xff\\\rfake\x7f\xc3\xa9");
    assert_eq!(format!("{:?}", version.vendor), r#""\x1b[2J\x00\xff\\\rfake\x7f\xc3\xa9""#);
}

#[test]
fn text_shows_line_ends_as_programmers_write_them() {
    assert_eq!(Text::from("a\r\nb").to_string(), r"a\r\nb");
}

#[test]
fn every_byte_is_shown_as_printable_ascii_and_none_is_lost() {
    let mut shown = std::collections::HashSet::new();
    for byte in 0..=255_u8 {
        let text = Text::from(&[byte][..]).to_string();
        assert!(text.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{byte:#x}: {text:?}");
        assert!(shown.insert(text), "{byte:#x} looks like another byte");
    }
}

fn specification(bracket: &str) -> Option<Specification> {
    version(format!("V\n0\nFIRM:3.3.00({bracket})").as_bytes()).specification
}

#[test]
fn the_valid_parts_of_a_bracket_are_read() {
    let parts = |bracket| {
        let found = specification(bracket).unwrap();
        (found.range, found.aperture, found.steps, found.motor_speed)
    };
    assert_eq!(parts("240[deg], 600[rpm]"), (None, Some(240), None, Some(600)));
    assert_eq!(parts("44-725[step],20-x[mm]"), (None, None, Some(44..=725), None));
    assert_eq!(parts("240[deg],725-44[step],0[rpm]"), (None, Some(240), None, None));
    for nonsense in
        ["", "20[mm]", "99999999999[rpm]", "-5[deg]", "600[rpm", "600 rpm]", "1[kg]", "[]", "]["]
    {
        assert_eq!(specification(nonsense), None, "{nonsense}");
    }
}
