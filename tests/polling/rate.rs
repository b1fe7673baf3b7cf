//! Bounds, text and conversions of `Rate`.

use std::time::Duration;

use tokio_scip::Rate;

const DAY: Duration = Duration::from_secs(24 * 60 * 60);

#[test]
fn rates_lie_between_a_day_and_a_millisecond() {
    let table = [
        (Rate::hz(10.0), Duration::from_millis(100)),
        (Rate::hz(1000.0), Duration::from_millis(1)),
        (Rate::hz(1e-9), DAY),
        (Rate::every(Duration::ZERO), Duration::from_millis(1)),
        (Rate::every(Duration::from_micros(999)), Duration::from_millis(1)),
        (Rate::every(Duration::from_micros(1001)), Duration::from_micros(1001)),
        (Rate::every(DAY), DAY),
        (Rate::every(Duration::MAX), DAY),
    ];
    for (rate, period) in table {
        assert_eq!(rate.period(), Some(period), "{rate}");
    }
    assert_eq!(Rate::UNLIMITED.period(), None);
}

#[test]
fn a_rate_is_parsed_from_its_own_text() {
    for (text, rate) in [
        ("10 Hz", Rate::hz(10.0)),
        ("12.5 Hz", Rate::hz(12.5)),
        ("0.1 Hz", Rate::every(Duration::from_secs(10))),
        ("0.0003333333333333 Hz", Rate::every(Duration::from_secs(3000))),
        ("1000 Hz", Rate::hz(1000.0)),
        ("max", Rate::UNLIMITED),
    ] {
        assert_eq!(rate.to_string(), text);
        assert_eq!(text.parse::<Rate>().unwrap(), rate);
    }
    assert_eq!("10".parse::<Rate>().unwrap(), Rate::hz(10.0));
    assert_eq!("10Hz".parse::<Rate>().unwrap(), Rate::hz(10.0));
    assert_eq!("10hz".parse::<Rate>().unwrap(), Rate::hz(10.0));
}

#[test]
fn an_invalid_rate_is_refused_with_the_valid_ones() {
    for text in [
        "", "0", "-1", "1001", "nan", "inf", "fast", "max Hz", "10 kHz", "Hz", "10HzHz",
        "10 Hz Hz", "HzHz",
    ] {
        let error = text.parse::<Rate>().unwrap_err().to_string();
        assert!(error.starts_with(&format!("invalid rate {text:?}: expected")), "{error}");
        assert!(error.contains("more than 0 and at most 1000 Hz"), "{error}");
    }
    for hz in [f64::NAN, f64::INFINITY, -1.0, -0.0, 0.0, 1000.1] {
        assert!(Rate::try_from(hz).is_err(), "{hz}");
        assert!(std::panic::catch_unwind(|| Rate::hz(hz)).is_err(), "{hz}");
    }
}

#[test]
fn a_rate_as_text_is_the_same_rate_again() {
    let (shortest, longest) = (1_000_000_u64, DAY.as_nanos() as u64);
    // The rates cover all orders of magnitude from one end to the other, evenly.
    let between = (0..5000).map(|n| {
        let part = f64::from(n) / 5000.0;
        (shortest as f64 * (longest as f64 / shortest as f64).powf(part)) as u64
    });
    for nanos in [shortest, shortest + 1, longest - 1, longest].into_iter().chain(between) {
        let rate = Rate::every(Duration::from_nanos(nanos));
        assert_eq!(rate.to_string().parse(), Ok(rate), "{rate}");
    }
}
