//! Replies of SCIP 2, whole and damaged. The encoder and the reference here are written from the
//! protocol text C-42-03320B, and share no code with the crate.

use tokio_scip::Window;
use tokio_scip::protocol::ReplyError;
use tokio_scip::protocol::scip2::{Command, Content, Data, Label, Reply, Request, Stamp, Stream};

use super::script::Script;

/// A line with its sum (p. 9).
fn line(text: &[u8]) -> Vec<u8> {
    let total: usize = text.iter().map(|&byte| usize::from(byte)).sum();
    [text, &[b'0' + (total % 64) as u8]].concat()
}

/// A number in `N` characters (p. 6).
fn encode<const N: usize>(number: u128) -> [u8; N] {
    std::array::from_fn(|at| b'0' + (number >> (6 * (N - 1 - at))) as u8 % 64)
}

/// What a case asks for, and what a sensor would answer.
pub(crate) struct Case {
    request: Request,
    echo: Vec<u8>,
    points: usize,
    data: Data,
    clock: usize,
    /// Distances, and intensities or none.
    values: (Vec<u32>, Vec<u32>),
    stamp: u64,
    left: u8,
}

impl Case {
    /// Draws a request with at most `most` points.
    pub(crate) fn draw(script: &mut Script<'_>, most: usize) -> Self {
        let cluster = 1 + script.byte() % 3;
        let points = 1 + script.below(most);
        let first = script.below(9000 - 3 * points) as u16;
        // The last cluster may be a part.
        let last =
            first + (points as u16 - 1) * u16::from(cluster) + script.below(cluster.into()) as u16;
        let window = Window::new(first..=last).unwrap().with_cluster_count(cluster).unwrap();
        let (data, letter, bits) = [
            (Data::Distances, 'D', 18),
            (Data::Intensities, 'E', 18),
            (Data::ShortDistances, 'S', 12),
        ][script.below(3)];
        let (skipped, count, left) = (script.byte() % 10, script.byte() % 100, script.byte());
        let left = left % (count + 1);
        let parameters = format!("{first:04}{last:04}{cluster:02}");
        let in_microseconds = script.byte() % 2 == 1;
        let (command, echo) = if script.byte() < 128 {
            (Command::Latest { data, window }, format!("G{letter}{parameters}"))
        } else {
            let stream = Stream::new(data, window).skipping(skipped).unwrap();
            let stream = if count > 0 { stream.ending_after(count).unwrap() } else { stream };
            let stream = if in_microseconds { stream.in_microseconds() } else { stream };
            let percent = if in_microseconds { "%" } else { "" };
            let echo = format!("{percent}M{letter}{parameters}{skipped}{left:02}");
            (Command::Stream(stream), echo)
        };
        let (label, echo) = match script.byte() % 3 {
            0 => (None, echo),
            _ => {
                let text = &"b.7 _+@Qx0123456"[..1 + script.below(16)];
                (Some(Label::new(text).unwrap()), format!("{echo};{text}"))
            }
        };
        let seed = u32::from(script.number());
        let draw = |at: usize| {
            (at as u32).wrapping_mul(2_654_435_761).wrapping_add(seed.wrapping_mul(40_503))
                >> (32 - bits)
        };
        let is_stream = matches!(command, Command::Stream(_));
        let is_long = in_microseconds && is_stream;
        let time = u64::from(script.number()) << 32 | u64::from(script.number()) << 8;
        let is_pair = data == Data::Intensities;
        Self {
            request: Request::new(command, label),
            echo: echo.into_bytes(),
            points,
            data,
            clock: if is_long { 11 } else { 4 },
            values: (
                (0..points).map(draw).collect(),
                (0..if is_pair { points } else { 0 }).map(|at| draw(at + 5000)).collect(),
            ),
            stamp: if is_long { time } else { time % (1 << 24) },
            left: if is_stream { left } else { 0 },
        }
    }

    /// The reply without its terminator.
    pub(crate) fn frame(&self) -> Vec<u8> {
        let status = if matches!(self.request.command(), Command::Stream(_)) { "99" } else { "00" };
        let stamp = match self.clock {
            4 => encode::<4>(self.stamp.into()).to_vec(),
            _ => encode::<11>(self.stamp.into()).to_vec(),
        };
        let mut characters = Vec::new();
        for (at, &distance) in self.values.0.iter().enumerate() {
            match self.data {
                Data::ShortDistances => characters.extend(encode::<2>(distance.into())),
                _ => characters.extend(encode::<3>(distance.into())),
            }
            characters
                .extend(self.values.1.get(at).into_iter().flat_map(|&i| encode::<3>(i.into())));
        }
        let mut frame = self.echo.clone();
        let lines = [status.as_bytes(), &stamp].into_iter().chain(characters.chunks(64));
        lines.for_each(|text| frame.extend([vec![b'\n'], line(text)].concat()));
        frame
    }

    /// Returns time, distances and intensities of a frame, or `None` if it is no scan.
    fn reference(&self, frame: &[u8]) -> Option<(u128, Vec<u32>, Vec<u32>)> {
        let lines: Vec<&[u8]> = frame.split(|&byte| byte == b'\n').collect();
        let [_, status, lines @ ..] = &lines[..] else { return None };
        let is_stream = matches!(self.request.command(), Command::Stream(_));
        let scan = if is_stream { b"99b" } else { b"00P" };
        let texts: Vec<&[u8]> = lines
            .iter()
            .map(|bytes| {
                let (_, text) = bytes.split_last()?;
                let alphabet = text.iter().all(|byte| (b'0'..=b'o').contains(byte));
                (alphabet && line(text) == *bytes).then_some(text)
            })
            .collect::<Option<_>>()?;
        let (stamp, texts) = texts.split_first()?;
        let (last, full) = texts.split_last()?;
        let shape = full.iter().all(|text| text.len() == 64) && (1..=64).contains(&last.len());
        let decode = |text: &[u8]| text.iter().fold(0, |n, &byte| n * 64 + u128::from(byte - b'0'));
        let size = if self.data == Data::ShortDistances { 2 } else { 3 };
        let all: Vec<u32> = texts.concat().chunks(size).map(|text| decode(text) as u32).collect();
        let (values, intensities) = match self.data {
            Data::Intensities => all.chunks(2).map(|pair| (pair[0], pair[pair.len() - 1])).unzip(),
            _ => (all, vec![]),
        };
        let characters = self.points * [size, 6][usize::from(self.data == Data::Intensities)];
        let is_scan = shape
            && *status == scan
            && texts.concat().len() == characters
            && stamp.len() == self.clock
            && decode(stamp) < 1 << 64;
        is_scan.then(|| (decode(stamp), values, intensities))
    }

    fn parse(&self, frame: &[u8]) -> Result<Reply, ReplyError> {
        Reply::parse(&self.request, frame)
    }
}

fn damage(frame: &mut Vec<u8>, script: &mut Script<'_>) {
    let at = script.below(frame.len() + 1);
    let end = frame.len().min(at + 1 + usize::from(script.byte()) % 140);
    match script.byte() % 9 {
        0 => drop(frame.drain(at..frame.len().min(at + 1))),
        1 => drop(frame.drain(at..end)),
        2 => frame.insert(at, b'\n'),
        3 => frame.insert(at, script.byte()),
        4 => frame.truncate(at),
        5 => drop(frame.splice(at..at, frame[at..end].to_vec())),
        6 if at + 1 < frame.len() => frame.swap(at, at + 1),
        7 => frame.iter_mut().skip(at).take(1).for_each(|byte| *byte = script.byte()),
        _ => frame.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << (end % 8)),
    }
}

/// Exactly the scans that the reference accepts are accepted, with the same values, and every error
/// message is one line of ASCII.
pub(crate) fn only_scans_of_the_text_are_accepted(script: &[u8]) {
    let mut script = Script::new(script);
    let case = Case::draw(&mut script, 400);
    let mut frame = case.frame();
    while !script.is_over() {
        damage(&mut frame, &mut script);
    }
    let shown = frame.escape_ascii();
    match case.parse(&frame) {
        Ok(reply) => {
            let Content::Scan(scan) = reply.content else {
                assert_eq!(reply.content, Content::Nothing, "{shown}");
                return;
            };
            let (time, distances, intensities) = case.reference(&frame).expect("a scan");
            let stamp = match scan.stamp {
                Stamp::Milliseconds(time) => time.into(),
                Stamp::Microseconds(time) => time.into(),
            };
            assert_eq!(time, stamp, "{shown}");
            assert_eq!((scan.distances(), scan.intensities()), (&distances[..], &intensities[..]));
        }
        Err(ReplyError::Foreign { .. } | ReplyError::MultiEcho { .. } | ReplyError::Uam) => {
            assert!(!frame.starts_with(&[&case.echo[..], b"\n"].concat()), "{shown}");
        }
        Err(error) => {
            assert_eq!(case.reference(&frame), None, "{error}: {shown}");
            let text = error.to_string();
            assert!(text.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{text}");
        }
    }
}

/// Any bytes as the reply to any request: an error, but no panic.
pub(crate) fn any_bytes_are_judged(script: &[u8]) {
    let mut script = Script::new(script);
    let case = Case::draw(&mut script, 90);
    let commands = [
        Command::Version,
        Command::Parameters,
        Command::State,
        Command::StateCode,
        Command::Clock,
        Command::ClockInMicroseconds,
        Command::LaserOn,
        *case.request.command(),
    ];
    let request = Request::new(commands[script.below(commands.len())], None);
    let prefix = [request.bytes(), b"\n00P\n"].concat();
    let rest = script.take(500);
    for frame in [rest, &[request.bytes(), rest].concat(), &[&prefix[..], rest].concat()] {
        if let Err(error) = Reply::parse(&request, frame) {
            let text = error.to_string();
            assert!(text.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{text}");
        }
    }
}

/// A whole reply has the values that were sent, and the length that was promised.
pub(crate) fn whole_scans_are_decoded(script: &[u8]) {
    let case = Case::draw(&mut Script::new(script), 1300);
    let frame = case.frame();
    assert_eq!(case.request.reply_len(), Some(frame.len() + 2));
    let Content::Scan(scan) = case.parse(&frame).unwrap().content else { panic!("no scan") };
    assert_eq!(scan.distances(), case.values.0);
    assert_eq!(scan.intensities(), case.values.1);
    assert_eq!(scan.left, case.left);
    assert_eq!(
        scan.stamp,
        match case.clock {
            4 => Stamp::Milliseconds(case.stamp as u32),
            _ => Stamp::Microseconds(case.stamp),
        }
    );
}

/// No flipped bit and no end that is missing passes, except in the number of scans left.
pub(crate) fn flipped_bits_and_missing_ends_are_refused(script: &[u8]) {
    let case = Case::draw(&mut Script::new(script), 80);
    let frame = case.frame();
    let label = case.echo.iter().position(|&byte| byte == b';').unwrap_or(case.echo.len());
    let left = match case.request.command() {
        Command::Stream(_) => label - 2..label,
        _ => 0..0,
    };
    for bit in (0..8 * frame.len()).filter(|bit| !left.contains(&(bit / 8))) {
        let mut flipped = frame.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        assert!(case.parse(&flipped).is_err(), "{bit} of {}", frame.escape_ascii());
    }
    for length in 0..frame.len() {
        assert!(case.parse(&frame[..length]).is_err(), "{length} of {}", frame.escape_ascii());
    }
}

/// No flipped bit in what a sensor says about itself passes, except bit 6 between two printable
/// characters of a text.
pub(crate) fn flipped_bits_in_an_identity_are_refused(script: &[u8]) {
    let mut script = Script::new(script);
    let mut word = |most: usize| -> String {
        let letter = |at: usize| char::from(b"aZ09.:,()[/ ;_"[at % 14]);
        format!(
            "H{}",
            (0..1 + script.below(most)).map(|_| letter(script.below(14))).collect::<String>()
        )
    };
    let number = |word: String| 1 + word.len() % 9;
    let version = ["VEND", "PROD", "FIRM", "PROT", "SERI"].map(|key| format!("{key}:{}", word(30)));
    let parameters = ["DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN"];
    let mut size = 1;
    let parameters = parameters.map(|key| {
        size += number(word(20));
        format!("{key}:{size}")
    });
    let state = ["MODL", "SCSP", "MESM", "STAT"].map(|key| format!("{key}:{}", word(30)));
    for (command, name, texts) in [
        (Command::Version, "VV", &version[..]),
        (Command::Parameters, "PP", &parameters[..]),
        (Command::State, "II", &state[..]),
    ] {
        let mut frame = format!("{name}\n00P").into_bytes();
        for text in texts {
            let line = line(text.as_bytes());
            let (sum, text) = line.split_last().unwrap();
            frame.extend([b"\n", text, b";", &[*sum]].concat());
        }
        let request = Request::new(command, None);
        assert!(Reply::parse(&request, &frame).is_ok(), "{}", frame.escape_ascii());
        for bit in 0..8 * frame.len() {
            let mut flipped = frame.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let is_unseen = bit % 8 == 6 && (b' '..=b'~').contains(&flipped[bit / 8]);
            let is_text = matches!(command, Command::Version | Command::State);
            let reply = Reply::parse(&request, &flipped);
            assert!(reply.is_err() || is_unseen && is_text, "{bit} of {}", frame.escape_ascii());
        }
    }
}
