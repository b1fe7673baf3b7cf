//! Any bytes as commands: the sensor answers in the form that the text requires.

use std::time::Duration;

use proptest::prelude::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use urg_emulator::{EmptyCommand, Emulator, Faults, Firmware, Mode, Model};

use super::instant_sensor;

/// Returns the bytes that arrive for `bytes` within an hour.
fn replies(emulator: &Emulator, bytes: &[u8]) -> Vec<u8> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
    runtime.unwrap().block_on(async {
        let mut link = emulator.link();
        link.write_all(bytes).await.unwrap();
        let mut received = Vec::new();
        let read = link.read_to_end(&mut received);
        let _ = tokio::time::timeout(Duration::from_secs(3600), read).await;
        received
    })
}

/// Bytes that are likely to be commands, or almost.
fn line() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        "[VLSGX][0-9]{0,14}".prop_map(String::into_bytes),
        "G[0-7][0-9]{2}[0-7][0-9]{2}[0-9]{2}".prop_map(String::into_bytes),
        "[%GMTVPIBQRSCHN][ADEMPSTVR0-2][0-9]{0,15}(;.{0,18})?".prop_map(String::into_bytes),
        proptest::collection::vec(any::<u8>(), 0..80),
    ]
    .prop_map(|line| line.into_iter().filter(|byte| !b"\r\n".contains(byte)).collect())
}

proptest! {
    #[test]
    fn a_reply_ends_in_two_line_feeds(line in line()) {
        let emulator = instant_sensor().firmware(Firmware::V3).empty_command(EmptyCommand::Status).build();
        let reply = replies(&emulator, &[&line[..], b"\n"].concat());
        let echo = &line[..line.len().min(64)];
        prop_assert!(reply.starts_with(&[echo, b"\n"].concat()));
        prop_assert!(reply.ends_with(b"\n\n"));
        let rest = &reply[echo.len() + 1..];
        prop_assert!(rest[1] == b'\n' && rest[0].is_ascii_graphic());
        // An error reply has no data, and only its end has two LFs in a row.
        prop_assert!(rest[0] == b'0' || rest.len() == 3);
        prop_assert_eq!(rest.windows(2).position(|pair| pair == b"\n\n"), Some(rest.len() - 2));
        prop_assert!(rest.split(|&byte| byte == b'\n').all(|line| line.len() <= 64));
    }

    #[test]
    fn a_reply_in_scip_2_has_a_status_and_its_sum(line in line(), number in 0..4_usize) {
        let model = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx][number];
        let emulator = instant_sensor().model(model).mode(Mode::Scip2).build();
        let mut reply = &replies(&emulator, &[&line[..], b"\n"].concat())[..];
        // Empty, or a command that locks the sensor.
        let is_silent = line.is_empty() || reply.is_empty() && model == Model::Urg04lx;
        prop_assert_eq!(reply.is_empty(), is_silent);
        let echo = &line[..line.len().min(64)];
        let mut count = 0;
        while let Some(end) = reply.windows(2).position(|pair| pair == b"\n\n") {
            let frame = &reply[..end];
            let lines: Vec<&[u8]> = frame[echo.len() + 1..].split(|&byte| byte == b'\n').collect();
            prop_assert!(count > 0 || frame.starts_with(&[echo, b"\n"].concat()));
            prop_assert!(lines[0].len() == 3 && lines.iter().all(|line| line.len() <= 66));
            let sum = lines[0][..2].iter().fold(0, |sum, byte| sum + u32::from(*byte));
            prop_assert_eq!(u32::from(lines[0][2]), (sum & 63) + 48);
            (reply, count) = (&reply[end + 2..], count + 1);
        }
        prop_assert!(reply.is_empty() || count > 1);
    }

    #[test]
    fn any_bytes_are_answered_without_a_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..2000),
        seed in any::<u64>(),
    ) {
        let faults: Faults =
            "late=0.3,lost=0.1,damaged=0.5,doubled=0.3,merged=0.2,noise=0.3,reset=0.1".parse().unwrap();
        let emulator = instant_sensor().faults(faults).seed(seed).build();
        prop_assert!(replies(&emulator, &bytes).len() < 1_000_000);
    }
}

#[test]
fn a_line_without_a_terminator_keeps_64_bytes() {
    let emulator = instant_sensor().build();
    replies(&emulator, &[&[b'V'; 100_000][..], b"\r"].concat());
    let lines: Vec<_> = emulator.log().into_iter().map(|line| line.line).collect();
    assert_eq!(lines, [vec![b'V'; 64]]);
}
