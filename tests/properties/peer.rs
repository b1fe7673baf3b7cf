//! A sensor and a port that follow a script: the driver's other end. The sensor is on
//! USB, speaks SCIP 1.1 or SCIP 2 (`peer_scip2`), writes the number of each scan into its data, and
//! works without faults after the script's end.
//!
//! No fault in the script makes another valid reply, so that no wrong reply may ever be
//! accepted: no bit is flipped, at most one byte is lost or added, and garbage has no
//! character of a reply.

use std::collections::VecDeque;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, Waker, ready};
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::time::{Instant, Sleep, sleep_until};
use tokio_scip::port::Connect;
use tokio_scip::protocol::Protocol;
use tokio_scip::{Error, ErrorKind, Scan};

use super::peer_scip2::ScriptedStream;
use super::script::Script;
use super::test_port::{FarEnd, TestPort};

/// A handle to the sensor; opens ports to it.
#[derive(Clone)]
pub(crate) struct Peer(Arc<Mutex<PeerState>>);

pub(crate) struct PeerState {
    pub(crate) protocol: Protocol,
    /// Scans that a sensor of SCIP 2 sends unasked.
    pub(super) stream: Option<ScriptedStream>,
    script: VecDeque<u8>,
    /// Bytes that each read delivers and each write accepts, repeated; 0 is "not ready".
    sizes: Vec<u8>,
    turns: usize,
    link: u64,
    ending: Option<PeerEnding>,
    refused: u8,
    /// Time until which writes stall.
    stalled: Option<Instant>,
    reader: Option<Waker>,
    /// Command line received so far, and whether it may be incomplete.
    line: Vec<u8>,
    torn: bool,
    /// Bytes on their way to the host, in order.
    sent: VecDeque<(Instant, u8)>,
    bytes_sent: u64,
    bytes_read: u64,
    /// Times at which each `G` that was answered with data arrived.
    pub(super) scans: Vec<Instant>,
    pub(crate) laser: bool,
    /// Number of `G`s for more than one step, which no fence is.
    pub(crate) polls: u64,
    /// Offset at which the reply to the last fence ends, if it was sent undamaged.
    fence: Option<u64>,
}

enum PeerEnding {
    Closed,
    Failed,
}

impl Peer {
    pub(crate) fn new(script: &[u8]) -> Self {
        let mut header = Script::new(script);
        let protocol = [Protocol::Scip1, Protocol::Scip2][usize::from(header.byte()) % 2];
        let sizes = header.take(4).to_vec();
        let script = header.take(usize::MAX).iter().copied().collect();
        Self(Arc::new(Mutex::new(PeerState {
            protocol,
            stream: None,
            script,
            sizes,
            turns: 0,
            link: 0,
            ending: None,
            refused: 0,
            stalled: None,
            reader: None,
            line: Vec::new(),
            torn: true,
            sent: VecDeque::new(),
            bytes_sent: 0,
            bytes_read: 0,
            scans: Vec::new(),
            laser: protocol == Protocol::Scip1,
            polls: 0,
            fence: None,
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, PeerState> {
        self.0.lock().unwrap()
    }

    /// Ends all faults.
    pub(crate) fn heal(&self) {
        let mut state = self.lock();
        state.script.clear();
        state.refused = 0;
    }
}

/// Returns the value at `step`: a digit in base 4000, repeated every three steps.
pub(super) fn code(request: u64, step: u64) -> u32 {
    20 + (request / 4000_u64.pow((step % 3) as u32) % 4000) as u32
}

impl PeerState {
    pub(super) fn next(&mut self) -> u8 {
        self.script.pop_front().unwrap_or(0)
    }

    /// Returns how many bytes this call may move; 0 is "not ready".
    fn size(&mut self) -> usize {
        self.turns += 1;
        match self.sizes.get(self.turns % self.sizes.len().max(1)) {
            None => usize::MAX,
            // Not for ever: a pattern of zeros alone would block the port.
            Some(0) => self.turns % 3,
            Some(size) => usize::from(*size),
        }
    }

    fn receive(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if byte != b'\n' {
                self.line.push(byte);
                continue;
            }
            let line = std::mem::take(&mut self.line);
            let torn = std::mem::take(&mut self.torn);
            if self.protocol == Protocol::Scip2 {
                self.answer_scip2(&line);
            } else if is_command(&line) {
                self.answer(&line);
            } else if !line.is_empty() {
                assert!(torn, "not a command: {}", line.escape_ascii());
                self.send(Duration::ZERO, &[&line, &b"\n1\n\n"[..]].concat());
            }
        }
    }

    fn answer(&mut self, line: &[u8]) {
        let window = |range| std::str::from_utf8(&line[range]).unwrap().parse::<u64>().unwrap();
        let mut reply = [line, b"\n0"].concat();
        let mut is_fence = false;
        match line {
            b"V" => reply.extend_from_slice(b"\nVEND:x\nSERI:H1"),
            b"L0" | b"L1" => self.laser = line == b"L1",
            _ => {
                let steps = window(1..4)..=window(4..7);
                is_fence = steps.start() == steps.end();
                self.polls += u64::from(!is_fence);
                let proven = self.fence.is_some_and(|end| end <= self.bytes_read);
                assert!(is_fence || proven, "polled before the fence was answered");
                if self.laser {
                    let request = self.scans.len() as u64;
                    let codes = steps.map(|step| code(request, step));
                    let data: Vec<u8> =
                        codes.flat_map(|c| [48 + (c >> 6) as u8, 48 + (c & 63) as u8]).collect();
                    data.chunks(64).for_each(|line| {
                        reply.push(b'\n');
                        reply.extend_from_slice(line);
                    });
                    self.scans.push(Instant::now());
                } else {
                    reply[line.len() + 1] = b'6';
                }
            }
        }
        reply.extend_from_slice(b"\n\n");
        self.deliver(&reply, is_fence);
    }

    pub(super) fn deliver(&mut self, whole: &[u8], is_fence: bool) {
        let mut reply = whole.to_vec();
        // Never at once: polling at the highest rate would stop the paused clock.
        let mut delay = Duration::from_millis(20);
        let decision = match self.next() {
            // Nothing protects a `V`: two that are damaged alike look like another sensor.
            // It is lost instead.
            0xa0..0xd0 if whole.starts_with(b"V") => 0x80,
            decision => decision,
        };
        let mut place = || usize::from(self.script.pop_front().unwrap_or(0)) % (whole.len() + 1);
        match decision {
            0..0x60 => delay = Duration::from_millis(20 + u64::from(decision) % 8 * 20),
            0x60..0x80 => delay = Duration::from_millis(20 * u64::from(self.next())),
            0x80..0x90 => reply.clear(),
            0x90..0xa0 => {} // Doubled, see below.
            0xa0..0xb0 => drop(reply.drain(place()..).next()),
            0xb0..0xc0 => reply.insert(place(), [b'\n', 0, 0xff][usize::from(decision) % 3]),
            0xc0..0xd0 => reply.truncate(place()),
            0xd0..0xe0 => {
                for _ in 0..decision % 16 {
                    // Neither digits nor letters.
                    let byte = self.next();
                    let harmless = !(0x30..0x7b).contains(&byte);
                    reply.insert(0, if harmless { byte } else { b'\n' });
                }
            }
            0xe0..0xe8 => self.ending = Some(PeerEnding::Closed),
            0xe8..0xf0 => self.ending = Some(PeerEnding::Failed),
            0xf0..0xf8 => {
                let stall = Duration::from_millis(20 * u64::from(self.next()));
                self.stalled = Some(Instant::now() + stall);
            }
            0xf8.. => (self.refused, self.ending) = (decision % 4, Some(PeerEnding::Closed)),
        }
        self.send(delay, &reply);
        if is_fence {
            // A lost last LF may be replaced by the byte that follows.
            let most = &whole[..whole.len() - 1];
            let before = self.bytes_sent - reply.len() as u64;
            let place = reply.windows(most.len()).position(|part| part == most);
            self.fence = place.map(|place| before + (place + whole.len()) as u64);
        }
        if (0x90..0xa0).contains(&decision) {
            let delay = Duration::from_millis(20 * u64::from(self.next()));
            self.send(delay, whole);
        }
        if let Some(reader) = self.reader.take() {
            reader.wake();
        }
    }

    fn send(&mut self, delay: Duration, bytes: &[u8]) {
        let last = self.sent.back().map(|(at, _)| *at);
        let at = (Instant::now() + delay).max(last.unwrap_or_else(Instant::now));
        self.bytes_sent += bytes.len() as u64;
        self.sent.extend(bytes.iter().map(|&byte| (at, byte)));
    }

    /// Returns the `G` that the scan answers. Panics if that is not its own.
    pub(crate) fn check(&self, scan: &Scan) -> u64 {
        let first = u64::from(scan.window().start());
        let digits = (first..).zip(scan.raw_values()).take(3);
        let request = digits.fold(0, |sum, (step, value)| {
            sum + u64::from(value - 20) * 4000_u64.pow((step % 3) as u32)
        });
        let whole =
            (first..).zip(scan.raw_values()).all(|(step, value)| value == code(request, step));
        assert!(whole, "mixed data: {scan:?}");
        let arrived = self.scans[request as usize];
        // A sensor of SCIP 2 sends scans unasked.
        let is_own = scan.times().requested_at <= arrived || self.protocol == Protocol::Scip2;
        assert!(
            is_own && arrived <= scan.received_at(),
            "the answer to {request} is attached to another request"
        );
        request
    }
}

fn is_command(line: &[u8]) -> bool {
    match line {
        b"V" | b"L0" | b"L1" => true,
        [b'G', steps @ .., b'0', b'1'] => {
            steps.len() == 6
                && steps.iter().all(u8::is_ascii_digit)
                && steps[..3] <= steps[3..]
                && steps[3..] <= b"768"[..]
        }
        _ => false,
    }
}

impl Connect for Peer {
    type Port = TestPort<Wire>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let mut state = self.lock();
        if state.refused > 0 {
            state.refused -= 1;
            return Err(ErrorKind::NoSuchPort { port: "scripted".to_owned() }.into());
        }
        state.link += 1;
        (state.ending, state.stalled, state.torn) = (None, None, true);
        let link = state.link;
        drop(state);
        Ok(TestPort(Wire { peer: self.clone(), link, timers: [None, None] }))
    }
}

/// One open port.
pub(crate) struct Wire {
    peer: Peer,
    link: u64,
    /// Timers for reading and for writing.
    timers: [Option<Pin<Box<Sleep>>>; 2],
}

fn wait(
    timer: &mut Option<Pin<Box<Sleep>>>,
    until: Instant,
    context: &mut Context<'_>,
) -> Poll<()> {
    let timer = timer.get_or_insert_with(|| Box::pin(sleep_until(until)));
    timer.as_mut().reset(until);
    timer.as_mut().poll(context)
}

impl FarEnd for Wire {
    fn read(
        &mut self,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let peer = self.peer.clone();
        let mut state = peer.lock();
        assert_eq!(state.link, self.link, "a port was read after a newer one was opened");
        loop {
            let now = Instant::now();
            state.send_streamed(now);
            if state.sent.front().is_some_and(|(at, _)| *at <= now) {
                let most = state.size().min(buffer.remaining());
                let count = state.sent.iter().take(most).take_while(|(at, _)| *at <= now).count();
                if count == 0 {
                    context.waker().wake_by_ref();
                    return Poll::Pending;
                }
                let bytes: Vec<u8> = state.sent.drain(..count).map(|(_, byte)| byte).collect();
                state.bytes_read += count as u64;
                buffer.put_slice(&bytes);
                return Poll::Ready(Ok(()));
            }
            match state.ending {
                Some(PeerEnding::Closed) => return Poll::Ready(Ok(())),
                Some(PeerEnding::Failed) => {
                    return Poll::Ready(Err(io::Error::from_raw_os_error(5)));
                }
                None => state.reader = Some(context.waker().clone()),
            }
            let sent = state.sent.front().map(|(at, _)| *at);
            let streamed = state.stream.as_ref().map(|stream| stream.next);
            let Some(next) = sent.into_iter().chain(streamed).min() else { return Poll::Pending };
            ready!(wait(&mut self.timers[0], next, context));
        }
    }

    fn write(&mut self, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let peer = self.peer.clone();
        let mut state = peer.lock();
        assert_eq!(state.link, self.link, "a port was written to after a newer one was opened");
        if state.ending.is_some() {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        if let Some(until) = state.stalled {
            state.torn = true;
            ready!(wait(&mut self.timers[1], until, context));
            state.stalled = None;
        }
        let count = state.size().min(bytes.len());
        if count == 0 {
            // A driver that stops waiting now has sent half a command.
            state.torn = true;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        state.receive(&bytes[..count]);
        Poll::Ready(Ok(count))
    }
}
