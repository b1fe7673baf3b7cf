//! Damage to a reply (rows W of the list of faults): all structural damage is refused,
//! and the share of flipped bits that cannot be detected is counted.

use tokio_scip::protocol::{Command, Reply, ReplyError, Window};

use super::encoder::{frame, frames, indoors, reply, spread};

/// Windows whose data is less than a line, exactly one, two lines, and as services use.
fn cases() -> Vec<(Command, Vec<u16>, Vec<u8>)> {
    [(384, 384), (0, 30), (0, 31), (0, 32), (44, 725), (0, 768)]
        .into_iter()
        .map(|(start, end)| {
            let window = Window::new(start..=end).unwrap();
            let values = spread(window.points());
            let reply = reply(&format!("G{start:03}{end:03}01"), &values);
            (Command::Distances(window), values, reply)
        })
        .collect()
}

/// Returns the scans found by a reader that cuts `bytes` at every double LF.
fn accepted(command: &Command, bytes: &[u8]) -> Vec<Vec<u16>> {
    frames(bytes)
        .into_iter()
        .filter_map(|frame| Reply::parse(command, frame).ok())
        .filter(|reply| reply.status.is_ok())
        .map(|reply| reply.values().to_vec())
        .collect()
}

#[test]
fn the_undamaged_reply_is_accepted() {
    for (command, values, reply) in cases() {
        assert_eq!(accepted(&command, &reply), [values]);
    }
}

#[test]
fn w03_an_invalid_character_is_detected_wherever_it_stands() {
    let command = Command::Distances(Window::DETECTION);
    for value in [0, 4095] {
        let whole = frame("G04472501", &[value; 682]);
        let strays = (0..=255).filter(|byte| !(0x30..=0x6f).contains(byte));
        for stray in strays {
            // The damage is in the first line, in the last one, alone, and twice.
            for places in
                [&[12][..], &[12, 13], &[77, 13], &[whole.len() - 1], &[12, whole.len() - 2]]
            {
                let mut damaged = whole.clone();
                places.iter().for_each(|&at| damaged[at] = stray);
                assert!(Reply::parse(&command, &damaged).is_err(), "{stray:#04x} at {places:?}");
            }
        }
    }
}

#[test]
fn w01_w06_a_reply_without_any_one_byte_is_never_accepted() {
    for (command, _, reply) in cases() {
        for at in 0..reply.len() {
            let damaged = [&reply[..at], &reply[at + 1..]].concat();
            assert!(accepted(&command, &damaged).is_empty(), "{command} without byte {at}");
        }
    }
}

#[test]
fn w02_w07_w12_a_reply_with_any_one_byte_more_is_never_accepted() {
    for (command, values, reply) in cases() {
        // After the first LF of the terminator another LF makes the same bytes, and any
        // other byte leaves no terminator.
        for at in 0..reply.len() {
            for byte in [reply[at], b'\n', b'\r', 0, b'0', 0xff] {
                let damaged = [&reply[..at], &[byte], &reply[at..]].concat();
                let found = accepted(&command, &damaged);
                if at + 2 >= reply.len() && byte == b'\n' {
                    assert_eq!(found, std::slice::from_ref(&values)); // An LF after the reply.
                } else {
                    assert!(found.is_empty(), "{command} with {byte:#x} before byte {at}");
                }
            }
        }
    }
}

#[test]
fn w15_a_truncated_reply_is_never_accepted() {
    for (command, _, reply) in cases() {
        for length in 0..reply.len() - 2 {
            // As a reader cuts it, and as if it had ended there.
            assert!(accepted(&command, &reply[..length]).is_empty());
            let ended = Reply::parse(&command, &reply[..length]);
            assert!(ended.is_err(), "{command}, {length} bytes of it");
        }
    }
}

#[test]
fn w15_a_truncated_reply_hides_no_whole_one() {
    for (command, _, reply) in cases() {
        for length in 1..reply.len() - 1 {
            let damaged = [&reply[..length], &reply].concat();
            assert!(accepted(&command, &damaged).is_empty(), "{command}, {length} bytes of it");
        }
    }
}

#[test]
fn w10_a_block_lost_or_doubled_is_never_accepted() {
    for (command, _, reply) in cases() {
        for start in (12..reply.len() - 2).step_by(65) {
            let end = (start + 65).min(reply.len() - 1);
            let lost = [&reply[..start], &reply[end..]].concat();
            assert!(accepted(&command, &lost).is_empty(), "{command} without the block at {start}");
            let doubled = [&reply[..end], &reply[start..]].concat();
            assert!(accepted(&command, &doubled).is_empty(), "{command}, block at {start} twice");
        }
    }
}

#[test]
fn w11_a_lost_line_end_is_never_accepted_whatever_takes_its_place() {
    let (command, _, reply) = cases().pop().unwrap();
    for at in (0..reply.len() - 2).filter(|&at| reply[at] == b'\n') {
        for byte in (0..=255).filter(|&byte| byte != b'\n') {
            let mut damaged = reply.clone();
            damaged[at] = byte;
            assert!(accepted(&command, &damaged).is_empty(), "{byte:#x} for the LF at {at}");
        }
    }
}

#[test]
fn w04_a_flipped_status_is_malformed_in_both_directions() {
    let success = frame("G00003101", &spread(32));
    let command = Command::Distances(Window::new(0..=31).unwrap());
    for bit in 0..8 {
        let mut damaged = success.clone();
        damaged[10] ^= 1 << bit;
        assert!(
            matches!(Reply::parse(&command, &damaged), Err(ReplyError::Malformed(_))),
            "bit {bit}"
        );
    }
    for status in 1..=255 {
        let refused = [b"G00003101\n", &[status][..]].concat();
        let reply = Reply::parse(&command, &refused);
        assert!(!reply.is_ok_and(|reply| reply.status.is_ok()), "{status:#x}");
    }
}

/// Flips every bit of a frame once. Returns how many flips are accepted, and of how many.
fn accepted_flips(window: Window, values: &[u16]) -> (usize, usize) {
    let echo = format!("G{:03}{:03}01", window.start(), window.end());
    let command = Command::Distances(window);
    let mut frame = frame(&echo, values);
    let mut undetected = 0;
    for at in 0..frame.len() {
        let original = frame[at];
        for bit in 0..8 {
            frame[at] = original ^ (1 << bit);
            let data = at >= 12 && original != b'\n';
            let hidden = data && (0x30..=0x6f).contains(&frame[at]);
            let parsed = Reply::parse(&command, &frame);
            assert_eq!(parsed.is_ok(), hidden, "bit {bit} of byte {at}");
            if let Ok(reply) = parsed {
                let found = reply.values();
                let wrong = found.iter().zip(values).filter(|(found, sent)| found != sent).count();
                assert_eq!((found.len(), wrong), (values.len(), 1));
                undetected += 1;
            }
        }
        frame[at] = original;
    }
    (undetected, frame.len() * 8)
}

#[test]
fn w08_undetectable_bits_are_as_rare_as_documented() {
    let points = Window::DETECTION.points();
    let shares = [indoors(points), spread(points)].map(|values| {
        let (undetected, bits) = accepted_flips(Window::DETECTION, &values);
        (undetected as f64 * 100.0 / bits as f64).round() as u32
    });
    assert_eq!(shares, [55, 61], "[indoors, evenly spread]");
}
