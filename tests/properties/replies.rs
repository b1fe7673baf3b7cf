//! Replies to all commands, whole and damaged: the parser accepts exactly what a
//! reference made from the protocol text accepts, with the same values.

use bytes::BytesMut;
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::protocol::{BaudRate, Command, Reply, Window};
use tokio_util::codec::{Decoder, Encoder};

use super::script::Script;

/// Returns status and values of a reply (C-42-3320-A p. 3 to 6), or `None` if it is
/// invalid.
fn reference(command: &Command, frame: &[u8]) -> Option<(u8, Vec<u16>)> {
    let lines: Vec<&[u8]> = frame.split(|&byte| byte == b'\n').collect();
    let [echo, status, data @ ..] = &lines[..] else { return None };
    let &&[status @ b'!'..=b'~'] = status else { return None };
    if *echo != &*command.bytes() {
        return None;
    }
    let values = match (command, status) {
        (Command::Distances(window), b'0') => values(data, window.points())?,
        (Command::Version, b'0') => {
            return data
                .iter()
                .any(|line| !line.is_empty())
                .then_some((status, vec![]))
                .or((data.len() > 1).then_some((status, vec![])));
        }
        _ => data.is_empty().then(Vec::new)?,
    };
    Some((status, values))
}

fn values(lines: &[&[u8]], points: usize) -> Option<Vec<u16>> {
    let (last, full) = lines.split_last()?;
    let shape = full.iter().all(|line| line.len() == 64) && (1..=64).contains(&last.len());
    let data = lines.concat();
    let alphabet = data.iter().all(|byte| (b'0'..=b'o').contains(byte));
    let sextet = |byte: u8| u16::from(byte - b'0');
    (shape && alphabet && data.len() == 2 * points)
        .then(|| data.chunks(2).map(|pair| sextet(pair[0]) << 6 | sextet(pair[1])).collect())
}

fn command(script: &mut Script<'_>) -> Command {
    match script.byte() % 8 {
        0 => Command::Version,
        1 => Command::LaserOn,
        2 => Command::LaserOff,
        3 => Command::BaudRate(BaudRate::ALL[script.below(6)]),
        4 => Command::Distances(Window::new(44..=725).unwrap()),
        _ => {
            let (one, other) = (script.below(769) as u16, script.below(769) as u16);
            let window = Window::new(one.min(other)..=one.max(other)).unwrap();
            let cluster = 1 + script.byte() % 99;
            Command::Distances(window.with_cluster_count(cluster).unwrap())
        }
    }
}

/// Makes a reply that a sensor might send.
fn whole(command: &Command, script: &mut Script<'_>) -> Vec<u8> {
    let mut frame = command.bytes().to_vec();
    let status = match script.byte() {
        status @ b'!'..=b'~' => status,
        _ => b'0',
    };
    frame.extend_from_slice(&[b'\n', status]);
    let data = match (command, status) {
        (Command::Distances(window), b'0') => {
            let seed = script.byte();
            (0..window.points() * 2).map(|at| b'0' + (at as u8 ^ seed) % 64).collect()
        }
        (Command::Version, b'0') => b"VEND: Hokuyo\nSERI: H0000001".to_vec(),
        _ => vec![],
    };
    for line in data.chunks(64) {
        frame.push(b'\n');
        frame.extend_from_slice(line);
    }
    frame
}

fn damage(frame: &mut Vec<u8>, script: &mut Script<'_>) {
    let at = script.below(frame.len() + 1);
    let end = frame.len().min(at + 1 + usize::from(script.byte()) % 130);
    match script.byte() % 8 {
        0 => drop(frame.drain(at..frame.len().min(at + 1))),
        1 => drop(frame.drain(at..end)),
        2 => frame.insert(at, b'\n'),
        3 => frame.insert(at, script.byte()),
        4 => frame.truncate(at),
        5 => drop(frame.splice(at..at, frame[at..end].to_vec())),
        6 => drop(frame.splice(0..0, script.take(end - at).to_vec())),
        _ => frame.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << (end % 8)),
    }
}

/// Exactly what the reference accepts is accepted, and every error message is one line
/// of ASCII.
pub(crate) fn only_what_the_text_allows_is_accepted(script: &[u8]) {
    let mut script = Script::new(script);
    let command = command(&mut script);
    let mut frame = whole(&command, &mut script);
    while !script.is_over() {
        damage(&mut frame, &mut script);
    }
    let expected = reference(&command, &frame);
    compare(&command, &frame, Reply::parse(&command, &frame), expected.clone());

    if let Command::Distances(window) = command {
        an_expected_scan_is_the_one_that_a_search_finds(window, &frame);
    }

    // The reply is accepted after other bytes, too.
    let accepted = match command {
        // Echo and status, each with its LF, and blocks of 64 bytes.
        Command::Distances(window) => {
            12 + 2 * window.points() + (2 * window.points()).div_ceil(64) - 1
        }
        _ => command.bytes().len() + 2,
    };
    let lengths = [accepted, command.bytes().len() + 2];
    let tails = lengths.iter().filter_map(|length| frame.get(frame.len().checked_sub(*length)?..));
    let tail = tails.filter_map(|tail| reference(&command, tail)).next();
    if command != Command::Version {
        compare(&command, &frame, Reply::parse_end(&command, &frame), tail.or(expected));
    }
}

/// A codec that expects a scan finds a valid one exactly where a codec that searches for
/// the end finds it, and leaves the same bytes after it.
fn an_expected_scan_is_the_one_that_a_search_finds(window: Window, frame: &[u8]) {
    let bytes = BytesMut::from(&[frame, b"\n\nL1"].concat()[..]);
    let command = Command::Distances(window);
    let first = |mut codec: ScipCodec| {
        let mut buffer = bytes.clone();
        let Some(Frame::Reply(frame)) = codec.decode(&mut buffer).unwrap() else { return None };
        Some((Reply::parse(&command, &frame).ok()?, buffer))
    };
    let mut expecting = ScipCodec::default();
    expecting.encode(&command, &mut BytesMut::new()).unwrap();
    let (expected, searched) = (first(expecting), first(ScipCodec::default()));
    assert_eq!(expected, searched, "{window} in {}", frame.escape_ascii());
}

fn compare(
    command: &Command,
    frame: &[u8],
    found: Result<Reply, tokio_scip::protocol::ReplyError>,
    expected: Option<(u8, Vec<u16>)>,
) {
    let found = match found {
        Ok(reply) => Some((char::from(reply.status) as u8, reply.values().to_vec())),
        Err(error) => {
            let shown = error.to_string();
            assert!(shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{shown}");
            None
        }
    };
    assert_eq!(found, expected, "{command} in {}", frame.escape_ascii());
}
