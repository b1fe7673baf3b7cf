//! Exhaustive tests: each single damage at each place of a reply of five lines, through the
//! whole driver; and at each place of a full scan, through the codec.

use bytes::BytesMut;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{Command, MalformedError, Reply};
use tokio_scip::{ErrorKind, Rate, Window};
use tokio_util::codec::Decoder;
use urg_emulator::{Emulator, Fault};

use super::rig::{Outcome, instant_sensor, scans, second_poll, streaming, wrong_scans};
use crate::common::faulty_link::FaultyLink;
use crate::common::{builder, reply_len, request_of};

/// Offset of the data, which follows echo, LF, status, LF.
const DATA: usize = 12;

/// Four whole lines of data, and a part of one.
fn window() -> Window {
    Window::new(300..=440).unwrap()
}

/// Returns the length of the second poll's reply. That poll asks for one step more.
fn length() -> usize {
    reply_len(Window::new(299..=440).unwrap())
}

/// Asserts that the poll brought no scan, and exactly one error.
fn assert_refused(outcome: &Outcome, what: &str) {
    let one =
        matches!(outcome.errors[..], [ErrorKind::Timeout { .. } | ErrorKind::Malformed { .. }]);
    assert!(!outcome.accepted && one, "{what}: {outcome:?}");
    assert!(outcome.stats.fences >= 2, "{what}: no fence was raised: {outcome:?}");
}

fn assert_unharmed(outcome: &Outcome, what: &str) {
    assert!(outcome.accepted && outcome.errors.is_empty(), "{what}: {outcome:?}");
}

#[tokio::test(start_paused = true)]
async fn w01_w05_w06_w11_each_byte_lost() {
    for at in 0..length() {
        let outcome = second_poll(window(), &[Fault::Drop(at..at + 1)]).await;
        assert_refused(&outcome, &format!("without byte {at}"));
    }
}

#[tokio::test(start_paused = true)]
async fn w02_w07_w12_each_byte_doubled() {
    for at in 0..length() {
        let outcome = second_poll(window(), &[Fault::Repeat(at..at + 1)]).await;
        // One more LF after the two that end a reply is harmless.
        let check = if at < length() - 2 { assert_refused } else { assert_unharmed };
        check(&outcome, &format!("byte {at} twice"));
    }
}

#[tokio::test(start_paused = true)]
async fn w02_w07_w12_w18_a_byte_inserted_at_each_place() {
    for byte in [b'\n', 0, 0xff] {
        for at in 0..=length() {
            let outcome = second_poll(window(), &[Fault::Insert(at, vec![byte])]).await;
            // A NUL before a reply is skipped; a byte after it is dropped before the next poll.
            let harmless = at == length()
                || at == length() - 1 && byte == b'\n'
                || at == length() - 2 && byte == b'\n'
                || at == 0 && byte == 0;
            let check = if harmless { assert_unharmed } else { assert_refused };
            check(&outcome, &format!("{byte:#x} before byte {at}"));
        }
    }
}

#[tokio::test(start_paused = true)]
async fn w15_a_reply_cut_at_each_length() {
    for kept in 0..length() {
        let outcome = second_poll(window(), &[Fault::Cut(kept)]).await;
        assert_refused(&outcome, &format!("{kept} bytes of it"));
        // The fence's reply is recognised after the remains of the damaged one.
        assert_eq!(outcome.stats.fence_timeouts, 0, "{kept} bytes of it");
    }
}

#[tokio::test(start_paused = true)]
async fn w10_each_block_of_64_bytes_lost_or_doubled() {
    for start in (DATA..length() - 1).step_by(65) {
        let block = start..(start + 65).min(length() - 1);
        for fault in [Fault::Drop(block.clone()), Fault::Repeat(block.clone())] {
            let outcome = second_poll(window(), std::slice::from_ref(&fault)).await;
            assert_refused(&outcome, &format!("{fault:?}"));
            assert!(matches!(outcome.errors[..], [ErrorKind::Malformed { .. }]), "{fault:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn w16_a_reply_split_at_each_place() {
    // Returns the number of bytes read before the reply to the poll.
    let stream = async |places: Vec<u64>| {
        let emulator = instant_sensor().build();
        let link = FaultyLink::new(emulator.link()).split_reads_at(places);
        let counter = link.counter();
        let sensor = builder().attach(link).await.unwrap();
        let before = counter.bytes_read();
        let scan = sensor.scan(window()).await.unwrap();
        assert_eq!(wrong_scans(&emulator, &[scan]), [""; 0]);
        let stats = sensor.stats();
        assert_eq!((stats.timeouts, stats.malformed.total(), stats.fences), (0, 0, 1));
        before
    };
    let before = stream(Vec::new()).await;
    for at in 1..reply_len(window()) as u64 {
        assert_eq!(stream(vec![before + at]).await, before);
    }
}

/// Flips one bit in the reply to the second poll. Returns `None` if that reply was
/// refused, else the number of points that differ from those sent.
async fn flip(at: usize, bit: u8) -> Option<usize> {
    let emulator = instant_sensor().build();
    let sensor = super::rig::open(&emulator).await;
    let window = Window::new(300..=340).unwrap();
    let mut stream = sensor.scans(window, Rate::hz(10.0)).await.unwrap();
    scans(&mut stream, 1).await;
    let sent = emulator.counts().scans;
    emulator.set_faults(urg_emulator::Faults::none().at(0, Fault::Flip(at, 1 << bit)));
    let next = scans(&mut stream, 2).await;
    assert!(request_of(&next[1]).is_some(), "the scan after the damaged one is wrong, too");
    // The damaged reply answers the first scan, or it was refused.
    let sent_value = |step: usize| 20 + [sent, 0, 0][(300 + step) % 3] as u32;
    let wrong = next[0].raw_values().enumerate().filter(|&(step, v)| v != sent_value(step)).count();
    (request_of(&next[0]).is_none_or(|request| request == sent)).then_some(wrong)
}

#[tokio::test(start_paused = true)]
async fn w03_w04_w08_w11_w13_each_bit_flipped() {
    let window = Window::new(300..=340).unwrap();
    let emulator = instant_sensor().build();
    let (_sensor, mut stream) = streaming(&emulator, window, Rate::hz(10.0)).await;
    scans(&mut stream, 1).await;
    // The second poll's reply: it asks for one step more on the left.
    let sent = emulator.counts().scans as u32;
    let values: Vec<u32> = (299..=340).map(|step| 20 + [sent, 0, 0][step % 3]).collect();
    let data: Vec<u8> =
        values.iter().flat_map(|v| [b'0' + (v >> 6) as u8, b'0' + (v & 63) as u8]).collect();
    let lines = data.chunks(64).collect::<Vec<_>>().join(&b'\n');
    let reply = [&b"G29934001\n0\n"[..], &lines, b"\n\n"].concat();
    for (at, &byte) in reply.iter().enumerate() {
        for bit in 0..8 {
            let found = flip(at, bit).await;
            let flipped = byte ^ (1 << bit);
            let in_data = at >= DATA && byte != b'\n';
            // A flip in the surplus point in front is not visible: the point is not delivered.
            let surplus = (DATA..DATA + 2).contains(&at);
            let expected = (in_data && (0x30..=0x6f).contains(&flipped)).then_some(if surplus {
                0
            } else {
                1
            });
            assert_eq!(found, expected, "bit {bit} of byte {at}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn w13_a_j_that_becomes_a_line_feed_at_each_place() {
    use urg_emulator::{Faults, Fixed, Pace};
    // 26 * 64 + 26 is sent as "JJ", and one flipped bit makes an LF of a 'J'.
    let emulator =
        Emulator::builder().world(Fixed::filled(26 * 64 + 26)).pace(Pace::AtOnce).build();
    let (sensor, mut stream) = streaming(&emulator, window(), Rate::hz(10.0)).await;
    // A poll may ask for no step more.
    for at in DATA..reply_len(window()) - 2 {
        scans(&mut stream, 1).await;
        let before = sensor.stats().scans;
        emulator.set_faults(Faults::none().at(0, Fault::Flip(at, b'J' ^ b'\n')));
        let error = loop {
            match stream.next().await.unwrap() {
                Ok(scan) => assert!(scan.raw_values().all(|v| v == 26 * 64 + 26), "at {at}"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error.kind(), ErrorKind::Malformed { .. }), "at {at}: {error:?}");
        assert_eq!(sensor.stats().scans, before, "at {at}");
    }
}

/// Counts the scans that codec and reply parser accept from `chunks`.
fn accepted<'a>(command: &Command, chunks: impl IntoIterator<Item = &'a [u8]>) -> usize {
    let (mut codec, mut buffer, mut count) = (ScipCodec::default(), BytesMut::new(), 0);
    for chunk in chunks {
        buffer.extend_from_slice(chunk);
        while let Some(frame) = codec.decode(&mut buffer).unwrap() {
            if let Frame::Reply(bytes) = frame {
                count += usize::from(Reply::parse(command, &bytes).is_ok());
            }
        }
    }
    count
}

#[test]
fn w16_w17_a_scan_may_be_split_anywhere() {
    let command = Command::Distances(Window::FULL);
    let data = vec![b'C'; 2 * 769];
    let lines = data.chunks(64).collect::<Vec<_>>().join(&b'\n');
    let one = [&b"G00076801\n0\n"[..], &lines, b"\n\n"].concat();
    assert_eq!(one.len(), 1576);
    let two = one.repeat(2);
    assert_eq!(accepted(&command, [&two[..]]), 2);
    for at in 0..=two.len() {
        assert_eq!(accepted(&command, [&two[..at], &two[at..]]), 2, "split at {at}");
    }
    for size in 1..=one.len() {
        assert_eq!(accepted(&command, two.chunks(size)), 2, "in pieces of {size}");
    }
    for at in 0..one.len() {
        let damaged = [&one[..at], &one[at + 1..], &one].concat();
        assert!(accepted(&command, damaged.chunks(7)) <= 1, "without byte {at}");
    }
}

#[tokio::test(start_paused = true)]
async fn w09_a_lost_and_an_added_byte_shift_points() {
    // No driver can detect this. The test shows its effect, and that it has no other.
    let emulator = instant_sensor().build();
    let (sensor, mut stream) = streaming(&emulator, Window::DETECTION, Rate::hz(10.0)).await;
    scans(&mut stream, 1).await;
    let faults = urg_emulator::Faults::none();
    // Two places in the same line, 20 bytes or ten points apart.
    let faults = faults.at(0, Fault::Drop(20..21)).at(0, Fault::Insert(40, vec![b'0']));
    emulator.set_faults(faults);
    let next = scans(&mut stream, 2).await;
    let shifted: Vec<u32> = next[0].raw_values().collect();
    assert_eq!(shifted.len(), 682);
    assert!(request_of(&next[0]).is_none());
    // The first point is surplus; ten and a half points lie between the two places.
    let (before, after) = (&shifted[..3], &shifted[14..]);
    let sent = |step: usize| 20 + [emulator_number(&next[1]) - 1, 0, 0][(44 + step) % 3] as u32;
    assert!(before.iter().enumerate().all(|(step, &value)| value == sent(step)));
    assert!(after.iter().enumerate().all(|(step, &value)| value == sent(step + 14)));
    assert!(request_of(&next[1]).is_some(), "the scan after it is whole");
    assert_eq!(sensor.stats().malformed.total(), 0);
}

fn emulator_number(scan: &tokio_scip::Scan) -> u64 {
    request_of(scan).unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_malformed_reply_is_reported_with_its_place() {
    let outcome = second_poll(window(), &[Fault::Drop(DATA + 65 * 3 + 5..DATA + 65 * 3 + 6)]).await;
    let [ErrorKind::Malformed { source, .. }] = &outcome.errors[..] else { panic!("{outcome:?}") };
    assert_eq!(*source, MalformedError::LineLength { line: 3, expected: 64, found: 63 });
}
