//! [`RecordedReply`]: a reply of the sensor, and what it says. Metadata take the place of one to `V`.

use std::collections::BTreeMap;
use std::ops::Range;
use std::time::SystemTime;

use super::stream::Model;
use tokio_scip::protocol::scip2::{self, Content, Data, Label, Parameters, Request, Stamp};
use tokio_scip::protocol::{Command, Reply};
use tokio_scip::{BaudRate, Geometry, Version, Window};

/// Lines that every sensor sends, each with its key in the metadata.
const LINES: [(&str, &str); 5] = [
    ("VEND", "vendor"),
    ("PROD", "product"),
    ("FIRM", "firmware"),
    ("PROT", "protocol"),
    ("SERI", "serial_number"),
];

/// Reply of the sensor, byte by byte.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedReply {
    /// Command of SCIP 1.1 that it answers, even if the reply is malformed. `None` for the reply to a
    /// fence and for an unsolicited one.
    pub command: Option<Command>,
    /// Request of SCIP 2 that it answers, even if the reply is malformed. `None` for an unsolicited reply.
    pub request: Option<Request>,
    /// Bytes of the reply, including the two LFs at its end.
    pub bytes: Vec<u8>,
    /// Wall clock when the first byte arrived.
    pub stamp: SystemTime,
}

/// What a reply is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ReplyKind {
    /// `V` or `VV`.
    Version,
    /// `PP`.
    Parameters,
    /// `G`, `GD` or `GE`, or a scan of a stream.
    Poll,
    Other,
}

/// Values of a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Values {
    pub(super) distances: Vec<u32>,
    /// One for each distance, or none.
    pub(super) intensities: Vec<u32>,
    /// Time of the sensor's clock, in SCIP 2.
    pub(super) clock: Option<Stamp>,
}

impl Values {
    /// Groups neighbours into clusters, as a sensor of SCIP 2 does: each has its least distance, or its
    /// least value if it has none.
    pub(super) fn cluster(&mut self, cluster_count: u8, geometry: &Geometry) {
        let rank = |value: u32| (geometry.measurement(value).distance().is_none(), value);
        let count = usize::from(cluster_count.max(1));
        let mut places: Vec<usize> = (0..self.distances.len()).collect();
        places.sort_by_key(|place| (place / count, self.distances.get(*place).copied().map(rank)));
        for values in [&mut self.distances, &mut self.intensities] {
            let nearest = places.iter().step_by(count);
            *values = nearest.filter_map(|place| values.get(*place).copied()).collect();
        }
    }
}

impl RecordedReply {
    /// Creates the reply to a request, as it is written on the wire.
    pub(super) fn new(request: &str, bytes: &[u8], stamp: SystemTime) -> Self {
        let (command, request) = (parse_command(request), parse_request(request));
        Self { command, request, bytes: bytes.to_vec(), stamp }
    }

    pub(super) fn kind(&self) -> ReplyKind {
        // After power-up in SCIP 2 the laser is off. The driver switches it on, and asks again.
        let is_refusal = self.request.is_some() && self.after_echo() == Some(b"\n10Q\n\n");
        if is_refusal || self.is_streamed() && self.after_echo() == Some(b"\n00P\n\n") {
            return ReplyKind::Other;
        }
        match (self.command, self.request.as_ref().map(Request::command)) {
            (Some(Command::Version), _) | (_, Some(scip2::Command::Version)) => ReplyKind::Version,
            (_, Some(scip2::Command::Parameters)) => ReplyKind::Parameters,
            (Some(Command::Distances(_)), _) => ReplyKind::Poll,
            _ if self.asked().is_some() => ReplyKind::Poll,
            _ => ReplyKind::Other,
        }
    }

    /// Kind of a successful reply that identifies the sensor.
    pub(super) fn identity(&self) -> Option<ReplyKind> {
        match self.kind() {
            kind @ ReplyKind::Version => self.version_lines().map(|_| kind),
            kind @ ReplyKind::Parameters => self.parameters().map(|_| kind),
            _ => None,
        }
    }

    /// Window that a poll asked for, if `model` is known and has it.
    pub(super) fn window(&self, model: Option<&Model>) -> Option<Window> {
        if self.kind() != ReplyKind::Poll {
            return None;
        }
        if let Some(Command::Distances(window)) = self.command {
            return Some(window);
        }
        let asked = self.asked()?;
        model?.window(asked.start(), asked.end(), asked.cluster_count())
    }

    /// Returns true for a reply that the sensor sent as a part of a stream.
    pub(super) fn is_streamed(&self) -> bool {
        let command = self.request.as_ref().map(Request::command);
        matches!(command, Some(scip2::Command::Stream(_)))
    }

    fn asked(&self) -> Option<Window> {
        match self.request.as_ref()?.command() {
            scip2::Command::Latest { window, .. } => Some(*window),
            scip2::Command::Stream(stream) => Some(stream.window),
            _ => None,
        }
    }

    /// Lines of a successful reply to `V` or `VV`, without sums.
    pub(super) fn version_lines(&self) -> Option<Vec<Vec<u8>>> {
        let is_ok = self.scip1().is_some() || matches!(self.scip2(), Some(Content::Version(_)));
        let lines = self.frame().filter(|_| is_ok)?.split(|&byte| byte == b'\n').skip(2);
        let lines = lines.map(|line| match line {
            [line @ .., b';', _] if self.request.is_some() => line,
            line => line,
        });
        Some(lines.filter(|line| !line.is_empty()).map(<[u8]>::to_vec).collect())
    }

    pub(super) fn parameters(&self) -> Option<Parameters> {
        let Content::Parameters(parameters) = self.scip2()? else { return None };
        Some(parameters)
    }

    pub(super) fn values(&self) -> Option<Values> {
        if let Some(Command::Distances(_)) = self.command {
            let distances = self.scip1()?.values().iter().map(|value| u32::from(*value)).collect();
            return Some(Values { distances, ..Values::default() });
        }
        let Content::Scan(scan) = self.scip2()? else { return None };
        Some(Values {
            distances: scan.distances().to_vec(),
            intensities: scan.intensities().to_vec(),
            clock: Some(scan.stamp),
        })
    }

    /// The same reply to another request, as it is written on the wire: with its echo, and in SCIP 2 with
    /// the status that a scan has there.
    pub(super) fn to(&self, asked: &[u8]) -> Option<Self> {
        let rest = self.after_echo()?;
        let request = std::str::from_utf8(asked).unwrap_or_default();
        let status: &[u8] = if request.starts_with('M') { b"\n99b" } else { b"\n00P" };
        let bytes = match self.request {
            Some(_) if self.values().is_some() => [asked, status, rest.get(4..)?].concat(),
            _ => [asked, rest].concat(),
        };
        Some(Self::new(request, &bytes, self.stamp))
    }

    /// Bytes after the echo of the request.
    pub(super) fn after_echo(&self) -> Option<&[u8]> {
        match (&self.command, &self.request) {
            (Some(command), _) => self.bytes.strip_prefix(&*command.bytes()),
            (_, Some(request)) => self.own()?.strip_prefix(request.bytes()),
            _ => None,
        }
    }

    /// Bytes after what an earlier reply has left in SCIP 2.
    fn own(&self) -> Option<&[u8]> {
        let echo = self.request.as_ref().map_or(&b""[..], Request::bytes);
        // All replies to a stream begin alike.
        let len = self.request.as_ref().and_then(Request::reply_len);
        if self.bytes.starts_with(echo) && len.is_none_or(|len| self.bytes.len() <= len) {
            return Some(&self.bytes);
        }
        let at = self.bytes.windows(echo.len()).rposition(|part| part == echo)?;
        self.bytes.get(at..)
    }

    /// Reply without its terminator.
    fn frame(&self) -> Option<&[u8]> {
        self.own()?.strip_suffix(b"\n\n")
    }

    /// Parses a successful reply of SCIP 1.1.
    fn scip1(&self) -> Option<Reply> {
        let reply = Reply::parse(self.command.as_ref()?, self.frame()?).ok()?;
        reply.status.is_ok().then_some(reply)
    }

    /// Parses a reply of SCIP 2. Only a successful one has content.
    fn scip2(&self) -> Option<Content> {
        Some(scip2::Reply::parse(self.request.as_ref()?, self.frame()?).ok()?.content)
    }
}

/// Lines of a reply to `V`. A line whose value is unknown has none.
pub(super) fn version_lines(metadata: &BTreeMap<String, String>) -> Vec<Vec<u8>> {
    // A line feed would end the line.
    let value = |key: &str| metadata.get(key).and_then(|value| value.lines().next());
    let line = |(name, key)| format!("{name}:{}", value(key).unwrap_or_default());
    let lines = LINES.map(line).into_iter();
    let status = value("status").map(|status| format!("STAT:{status}"));
    lines.chain(status).map(String::into_bytes).collect()
}

pub(super) fn parse_version(lines: &[Vec<u8>]) -> Option<Version> {
    let frame = [b"V\n0\n".to_vec(), lines.join(&b'\n')].concat();
    Reply::parse(&Command::Version, &frame).ok().map(|reply| Version::from_reply(&reply))
}

/// Returns the command of a request that asks which sensor it is: `V`, and in SCIP 2 `PP` and `VV`.
pub(super) fn identity_command(request: &str) -> Option<&'static str> {
    let command = request.split(';').next()?;
    ["V", "PP", "VV"].into_iter().find(|known| *known == command)
}

fn parse_command(text: &str) -> Option<Command> {
    let number = |digits: Range<usize>| text.get(digits)?.parse::<u16>().ok();
    let distances = || {
        let window = Window::new(number(1..4)?..=number(4..7)?).ok()?;
        window.with_cluster_count(number(7..9)?.try_into().ok()?).ok().map(Command::Distances)
    };
    let fixed = [Command::Version, Command::LaserOn, Command::LaserOff];
    let speeds = BaudRate::ALL.map(Command::BaudRate);
    let mut known = distances().into_iter().chain(fixed).chain(speeds);
    // A window may have more steps than a `G` can name.
    known.find(|command| command.to_string() == text)
}

/// Parses a request of SCIP 2, of those that a driver sends.
fn parse_request(text: &str) -> Option<Request> {
    use scip2::Command as C;
    let (text, label) = match text.split_once(';') {
        Some((text, label)) => (text, Some(Label::new(label).ok()?)),
        None => (text, None),
    };
    let number = |digits: Range<usize>| text.get(digits)?.parse::<u16>().ok();
    let scans = |data| {
        let window = Window::new(number(2..6)?..=number(6..10)?).ok()?;
        let window = window.with_cluster_count(number(10..12)?.try_into().ok()?).ok()?;
        let Some(skipped) = number(12..13) else { return Some(C::Latest { data, window }) };
        let stream = scip2::Stream::new(data, window).skipping(skipped.try_into().ok()?);
        stream.ok().map(C::Stream)
    };
    let scans = [Data::Distances, Data::Intensities].into_iter().filter_map(scans);
    let fixed = [C::Version, C::Parameters, C::State, C::StateCode, C::LaserOn, C::LaserOff];
    let speeds = BaudRate::ALL.map(C::BaudRate);
    let mut known = scans.chain(fixed).chain(speeds);
    let command = known.find(|command| command.to_string() == text)?;
    Some(Request::new(command, label))
}
