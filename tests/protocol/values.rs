//! The meaning of each value, and the six baud rates.

use tokio_scip::protocol::{BaudRate, Command, Geometry, Measurement, Protocol, Text, Window};

use crate::common::{reply_len, wire_time};

/// Table of error codes, p. 7.
const MEANINGS: [&str; 20] = [
    "Possibility of detected object is at 22m",
    "Reflected light has low intensity",
    "Reflected light has low intensity",
    "Reflected light has low intensity",
    "Reflected light has low intensity",
    "Reflected light has low intensity",
    "Possibility of detected object is at 5.7m",
    "Distance data on the preceding and succeeding steps have errors",
    "Others",
    "The same step had error in the last two scan",
    "Others",
    "Others",
    "Others",
    "Others",
    "Others",
    "Others",
    "Possibility of detected object is in the range 4096mm~5.6m",
    "Others",
    "Unspecified",
    "Non-Measurable Distance",
];

#[test]
fn all_twenty_error_codes_have_the_meaning_of_the_text() {
    for (number, meaning) in (0..=19).zip(MEANINGS) {
        let measurement = Geometry::URG_04LX.measurement(number);
        let Measurement::Error(code) = measurement else { panic!("{measurement:?}") };
        assert_eq!((u32::from(code), code.meaning()), (number, meaning));
        assert_eq!(code.to_string(), format!("error code {number}: {meaning}"));
        let is_beyond = measurement.range() == f32::INFINITY;
        assert_eq!(is_beyond, meaning.starts_with("Possibility"));
    }
}

#[test]
fn every_value_is_an_error_a_distance_or_saturated() {
    for value in 0..4096 {
        let measurement = Geometry::URG_04LX.measurement(value);
        match value {
            0..=19 => assert!(matches!(measurement, Measurement::Error(_))),
            20..=4094 => assert_eq!(measurement, Measurement::Distance(value)),
            _ => assert_eq!(measurement, Measurement::Saturated(value)),
        }
        assert_eq!(measurement.value(), value);
        assert_eq!(measurement.distance(), (20..=4094).contains(&value).then_some(value));
    }
}

#[test]
fn ranges_follow_rep_117_code_by_code() {
    for value in 0..4096 {
        let range = Geometry::URG_04LX.measurement(value).range();
        match value {
            0 | 6 | 16 | 4095 => assert_eq!(range, f32::INFINITY, "{value}"),
            1..=5 | 7..=15 | 17..=19 => assert!(range.is_nan(), "{value}"),
            millimetres => {
                assert!((range - millimetres as f32 / 1000.0).abs() < 1e-6, "{value}");
                assert!((0.020..=4.094).contains(&range), "{value}");
            }
        }
    }
    assert_eq!(Geometry::URG_04LX.measurement(1234).range(), 1.234);
}

#[test]
fn the_six_baud_rates_have_the_digits_of_the_text() {
    let text = ["019200", "057600", "115200", "250000", "500000", "750000"];
    for (speed, digits) in BaudRate::ALL.into_iter().zip(text) {
        let sent = Command::BaudRate(speed).bytes();
        assert_eq!(sent[1..7], *digits.as_bytes());
        let bits = u32::from(speed);
        assert_eq!(format!("{bits:06}"), digits);
        assert_eq!(BaudRate::try_from(bits), Ok(speed));
        assert_eq!(u32::from(speed), bits);
        assert_eq!(speed.to_string().parse(), Ok(speed));
    }
}

#[test]
fn a_text_keeps_every_byte() {
    let text = Text::from("H0713090");
    assert_eq!((text.to_string(), text.as_str()), ("H0713090".to_owned(), Some("H0713090")));
    assert!(text == "H0713090" && &text == "H0713090");
    let (same, other) = (String::from("H0713090"), String::from("H0713091"));
    assert!(text == same && text != other);
    assert_eq!((Text::from(&same), Text::from(same)), (text.clone(), text.clone()));
    assert!(text != "H0713091" && &text != "H071309" && text != Text::default());
    assert_eq!(Text::from(""), Text::default());
    assert_eq!(Text::from(&b"H\xff\0"[..]).as_ref(), b"H\xff\0");
}

#[test]
fn other_baud_rates_are_refused_by_name() {
    for text in ["", "9600", "38400", "115200.0", "115 200", "fast", "-19200", "99999999999"] {
        let error = text.parse::<BaudRate>().unwrap_err().to_string();
        assert!(error.contains(&format!("{text:?}")) && error.contains("115200"), "{error}");
    }
    assert!(BaudRate::try_from(0).is_err());
}

#[test]
fn replies_take_the_milliseconds_of_the_table() {
    let clustered = Window::DETECTION.with_cluster_count(2).unwrap();
    for (window, bytes, milliseconds) in [
        (Window::FULL, 1576, [821, 274, 137, 63, 32, 21]),
        (Window::DETECTION, 1399, [729, 243, 121, 56, 28, 19]),
        (clustered, 706, [368, 123, 61, 28, 14, 9]),
    ] {
        assert_eq!(reply_len(window), bytes);
        for (speed, expected) in BaudRate::ALL.into_iter().zip(milliseconds) {
            // A poll is longer by the ten bytes of its command.
            let time = window.wire_time(speed, Protocol::Scip1) - wire_time(speed, 10);
            assert_eq!((time.as_secs_f64() * 1000.0).round() as u32, expected, "{window}, {speed}");
        }
    }
}
