//! A fence's reply is found after the remains of another reply, and nowhere else.

use tokio_scip::protocol::{BaudRate, Command, Reply, Window};

use super::encoder::{frame, reply, spread};

/// Returns a `G` for one step, with its reply of success and of refusal.
fn fence(step: u16) -> (Command, Vec<u8>, Vec<u8>) {
    let echo = format!("G{step:03}{step:03}01");
    let refused = [echo.as_bytes(), b"\n6"].concat();
    (Command::Distances(Window::new(step..=step).unwrap()), frame(&echo, &[1234]), refused)
}

#[test]
fn w15_a_fence_is_found_after_any_truncated_reply() {
    for before in [
        reply("G04472501", &spread(682)),
        reply("G00076801", &spread(769)),
        reply("G00003101", &spread(32)),
        reply("G38438401", &[0]),
        b"G04472501\n6\n\n".to_vec(),
        b"L1\n0\n\n".to_vec(),
        b"V\n0\nVEND:Hokuyo\nSERI:H1\n\n".to_vec(),
    ] {
        let (command, accepted, refused) = fence(385);
        for length in 0..before.len() {
            let glued = [&before[..length], &accepted].concat();
            let found = Reply::parse_end(&command, &glued).unwrap();
            assert!(found.status.is_ok());
            assert_eq!(found.values(), [1234]);
            let glued = [&before[..length], &refused].concat();
            let found = Reply::parse_end(&command, &glued).unwrap();
            assert_eq!(char::from(found.status), '6');
        }
    }
}

#[test]
fn no_whole_reply_of_another_command_ends_in_a_fence() {
    // Its data contains the bytes of a fence wherever possible.
    let spelled = |step: u16, points: usize| -> Vec<u16> {
        let echo = format!("G{step:03}{step:03}01");
        let text: Vec<u8> = echo.bytes().chain(*b"0CD").cycle().take(points * 2).collect();
        text.chunks(2).map(|pair| u16::from(pair[0] - 48) * 64 + u16::from(pair[1] - 48)).collect()
    };
    for step in 0..=768 {
        let (command, _, _) = fence(step);
        let other = (step + 1) % 769;
        for frame in [
            frame("G00076801", &spelled(step, 769)),
            frame("G04472501", &spelled(step, 682)),
            frame("G00003201", &spelled(step, 33)),
            fence(other).1,
            fence(other).2,
            b"G00076801\n6".to_vec(),
            b"L1\n0".to_vec(),
            [&Command::BaudRate(BaudRate::B19200).bytes()[..], b"\n0"].concat(),
            b"V\n0\nVEND: Hokuyo\nSERI: H0400000".to_vec(),
        ] {
            assert!(Reply::parse_end(&command, &frame).is_err(), "fence {step} in {frame:?}");
        }
    }
}

#[test]
fn a_damaged_fence_is_not_found() {
    let (command, accepted, refused) = fence(385);
    for whole in [accepted, refused] {
        for at in 0..whole.len() {
            let glued = [b"G04472501\n0\n0000", &whole[..at], &whole[at + 1..]].concat();
            assert!(Reply::parse_end(&command, &glued).is_err(), "without byte {at}");
        }
        let glued = [b"G04472501\n0\n0000", &whole[..], b"0"].concat();
        assert!(Reply::parse_end(&command, &glued).is_err());
    }
}

#[test]
fn an_error_covers_the_whole_frame() {
    let (command, _, _) = fence(385);
    let frame = b"G38538501\n0\nCD\nCD";
    assert_eq!(Reply::parse_end(&command, frame), Reply::parse(&command, frame));
    assert!(Reply::parse_end(&command, b"").is_err());
}
