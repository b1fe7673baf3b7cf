//! The line of the model: what becomes of each command and each reply is a choice. It
//! keeps the order of replies, as every line does.

use std::collections::VecDeque;
use std::fmt::Write;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use tokio::io::ReadBuf;
use tokio::sync::watch;
use tokio::time::{Instant, Sleep, sleep_until};
use tokio_scip::port::Connect;
use tokio_scip::{BaudRate, Error};

use super::chooser::Chooser;
use super::fate::Fate;
use super::scip2::reply;
use super::sensor::ModelSensor;
use crate::common::test_port::{FarEnd, TestPort};
use crate::common::wire_time;

/// Time from a command to its reply.
const TURNAROUND: Duration = Duration::from_millis(20);
/// Delay of a late reply after a later command: after its bytes, before its reply.
const LAG: Duration = Duration::from_millis(6);
/// Delay of a copy after its reply, before the next poll of a grid.
const SOON: Duration = Duration::from_millis(3);

/// Bytes on their way to the host.
struct Packet {
    bytes: Vec<u8>,
    due: Due,
    /// Baud rate at which the sensor sent them.
    baud_rate: Option<BaudRate>,
}

/// When a packet comes: never before an earlier one.
#[derive(Clone, Copy)]
enum Due {
    At(Instant),
    /// A place after the command of this number.
    Command(u64),
}

/// Number of exchanges with a choice, and how many of them may have a fault.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Depth {
    pub(crate) exchanges: usize,
    pub(crate) faults: usize,
}

/// What is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cut {
    /// The cable is pulled and put back; what was on it is lost.
    Cable,
    /// The port is hung up, and the system keeps what comes for the next link.
    Port,
    /// The sensor restarts, and the port does not see it.
    Power,
    /// The sensor restarts, and the port is gone for a moment, as on USB.
    PowerAndCable,
}

/// Sensor, the line to it, and the choices.
pub(crate) struct LineState {
    pub(crate) chooser: Chooser,
    pub(crate) sensor: ModelSensor,
    fates: &'static [Fate],
    /// True once a fate was another than on time.
    pub(crate) is_faulty: bool,
    /// Rest of the depth; 0 before the choices begin.
    left: Depth,
    queue: VecDeque<Packet>,
    /// Half of a command that was written.
    input: Vec<u8>,
    /// Number of commands so far.
    commands: u64,
    /// Number of the open link.
    link: u64,
    /// Number of places so far: each command and each packet is one.
    places: watch::Sender<usize>,
    /// Copy of a stream's scan that comes after the next one.
    held: Option<Packet>,
    /// Place in the sequence, and what is cut there: the link or the power.
    cut: Option<(usize, Cut)>,
    /// True if what is on the line is lost before the port is opened again.
    is_unplugged: bool,
    reader: Option<Waker>,
    started_at: Instant,
    /// A drawing of the sequence, if requested.
    pub(crate) drawing: Option<String>,
}

/// A handle to the line, which opens links to it.
#[derive(Clone)]
pub(crate) struct ModelLine(Arc<Mutex<LineState>>);

impl ModelLine {
    pub(crate) fn new(
        chooser: Chooser,
        sensor: ModelSensor,
        fates: &'static [Fate],
        draws: bool,
    ) -> Self {
        Self(Arc::new(Mutex::new(LineState {
            chooser,
            sensor,
            fates,
            is_faulty: false,
            left: Depth { exchanges: 0, faults: 0 },
            queue: VecDeque::new(),
            input: Vec::new(),
            commands: 0,
            link: 0,
            places: watch::Sender::new(0),
            held: None,
            cut: None,
            is_unplugged: false,
            reader: None,
            started_at: Instant::now(),
            drawing: draws.then(String::new),
        })))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, LineState> {
        self.0.lock().unwrap()
    }

    /// Begins to choose.
    pub(crate) fn begin(&self, depth: Depth, cut: Option<(usize, Cut)>) {
        let mut state = self.lock();
        state.places.send_replace(0);
        (state.left, state.cut) = (depth, cut);
    }

    /// Returns true once all choices were made, and what was to be cut was.
    pub(crate) fn is_done(&self) -> bool {
        let state = self.lock();
        state.left.exchanges == 0 && state.cut.is_none()
    }

    /// Waits for a place.
    pub(crate) async fn reached(&self, place: usize) {
        let mut places = self.lock().places.subscribe();
        places.wait_for(|now| *now >= place).await.unwrap();
    }

    pub(crate) fn draw(&self, text: &str) {
        self.lock().draw(text);
    }
}

impl LineState {
    fn draw(&mut self, text: &str) {
        let at = self.started_at.elapsed().as_millis();
        if let Some(drawing) = &mut self.drawing {
            writeln!(drawing, "{at:>7} ms  {text}").unwrap();
        }
    }

    /// Draws an arrow with the bytes on it.
    fn draw_bytes(&mut self, arrow: [&str; 2], bytes: &[u8], comment: &str) {
        if self.drawing.is_some() {
            let (text, [tail, head]) = (bytes.escape_ascii().to_string(), arrow);
            let text: String = text.chars().take(40).collect();
            self.draw(&format!("host {tail} {text:<40} {head} sensor  {comment}"));
        }
    }

    /// Chooses the fate of a command and its reply, or of a scan that comes unasked.
    fn choose_fate(&mut self, command: Option<&[u8]>) -> Fate {
        if self.left.exchanges == 0 {
            return Fate::OnTime;
        }
        self.left.exchanges -= 1;
        if self.left.faults == 0 {
            return Fate::OnTime;
        }
        let can_apply = |fate: &Fate| match fate {
            Fate::Ignored => command.is_some_and(|line| self.sensor.can_disobey(line)),
            Fate::Refused => command.is_none_or(|line| self.sensor.can_refuse(line)),
            Fate::CommandLost => command.is_some(),
            _ => true,
        };
        let fates: Vec<Fate> = self.fates.iter().copied().filter(can_apply).collect();
        let choice = self.chooser.choose(fates.len());
        self.left.faults -= usize::from(choice > 0);
        self.is_faulty |= choice > 0;
        fates[choice]
    }

    /// Counts a place, and cuts what is to be cut there.
    fn pass_place(&mut self) {
        let mut place = 0;
        self.places.send_modify(|now| {
            *now += 1;
            place = *now;
        });
        let Some((_, cut)) = self.cut.filter(|(at, _)| place >= *at) else { return };
        self.cut = None;
        self.draw(&format!("cut: {cut:?}"));
        if cut != Cut::Power {
            self.link += 1;
            self.input.clear();
        }
        self.is_unplugged = matches!(cut, Cut::Cable | Cut::PowerAndCable);
        if self.is_unplugged {
            self.queue.clear();
            self.held = None;
        }
        if matches!(cut, Cut::Power | Cut::PowerAndCable) {
            self.sensor.restart();
        }
    }

    /// Receives a command line, and sends its reply on its way.
    fn receive(&mut self, line: &[u8], host: Option<BaudRate>) {
        self.send_scans();
        self.sensor.update();
        self.commands += 1;
        let (now, number) = (Instant::now(), self.commands);
        for packet in &mut self.queue {
            if matches!(packet.due, Due::Command(due) if due <= number) {
                packet.due = Due::At(now + LAG);
            }
        }
        if host != self.sensor.baud_rate {
            self.draw_bytes(["~~", "~>"], line, "another baud rate");
            return;
        }
        let fate = self.choose_fate(Some(line));
        self.draw_bytes(["--", "->"], line, if fate == Fate::OnTime { "" } else { fate.name() });
        let reply = match fate {
            Fate::CommandLost => None,
            Fate::Ignored => Some(reply(line, b"00", &[])),
            Fate::Refused => Some(reply(line, b"0M", &[])),
            _ => self.sensor.answer(line),
        };
        let Some(reply) = reply else { return };
        let begun = now + self.wire_time(line.len() + 1);
        let latency = if line[0] == b'G' { 500 } else { 1000 };
        self.send(reply, fate, begun, TURNAROUND, Duration::from_millis(latency));
    }

    /// Sends what the stream has brought since the last time.
    fn send_scans(&mut self) {
        while let Some((at, mut scan)) = self.sensor.next_scan() {
            let fate = self.choose_fate(None);
            if fate != Fate::OnTime {
                self.draw(&format!("a scan is sent: {}", fate.name()));
            }
            if fate == Fate::Refused {
                let echo = scan.split(|byte| *byte == b'\n').next().unwrap();
                scan = reply(echo, b"21", &[]);
            }
            if fate == Fate::DoubledAfterNext {
                self.send(scan.clone(), Fate::OnTime, at, Duration::ZERO, Duration::ZERO);
                let copy =
                    Packet { bytes: scan, due: Due::At(at), baud_rate: self.sensor.baud_rate };
                self.queue.extend(self.held.replace(copy));
                continue;
            }
            self.send(scan, fate, at, Duration::ZERO, Duration::from_secs(1));
            self.queue.extend(self.held.take());
        }
    }

    fn wire_time(&self, bytes: usize) -> Duration {
        let baud_rate = self.sensor.baud_rate;
        baud_rate.map_or(Duration::ZERO, |baud_rate| wire_time(baud_rate, bytes))
    }

    /// Sends a reply on its way, which would begin after `turnaround` and is too late after `latency`.
    fn send(
        &mut self,
        mut reply: Vec<u8>,
        fate: Fate,
        begun: Instant,
        turnaround: Duration,
        latency: Duration,
    ) {
        let (baud_rate, number) = (self.sensor.baud_rate, self.commands);
        let on_the_wire = self.wire_time(reply.len());
        let on_time = Due::At(begun + turnaround + on_the_wire);
        let deadline = begun + latency + on_the_wire;
        let mut copy = None;
        let due = match fate {
            Fate::OnTime | Fate::Refused | Fate::Ignored => on_time,
            Fate::Late => Due::At(deadline - Duration::from_millis(1)),
            Fate::AtDeadline => Due::At(deadline),
            Fate::AfterNext => Due::Command(number + 1),
            Fate::AfterSecond => Due::Command(number + 2),
            Fate::Lost | Fate::CommandLost => return,
            Fate::Cut => {
                reply.truncate(reply.len() / 2);
                on_time
            }
            Fate::Damaged => {
                let place = reply.len() - 3;
                reply[place] = 0x7f;
                on_time
            }
            Fate::Flipped => {
                let place = reply.len() - 4;
                reply[place] ^= 1;
                on_time
            }
            Fate::Merged => {
                reply.pop();
                on_time
            }
            Fate::Doubled => {
                reply = reply.repeat(2);
                on_time
            }
            Fate::DoubledSoon => {
                copy = Some(Due::At(begun + turnaround + on_the_wire + SOON));
                on_time
            }
            Fate::DoubledAfterNext => {
                copy = Some(Due::Command(number + 1));
                on_time
            }
        };
        let copy = copy.map(|due| Packet { bytes: reply.clone(), due, baud_rate });
        self.queue.extend([Packet { bytes: reply, due, baud_rate }].into_iter().chain(copy));
    }

    /// Reads what has come, or returns the time at which more comes if that is known.
    fn read(
        &mut self,
        host: Option<BaudRate>,
        buffer: &mut ReadBuf<'_>,
    ) -> Result<(), Option<Instant>> {
        self.send_scans();
        let packet = self.queue.front_mut().ok_or(self.sensor.next_at())?;
        let Due::At(at) = packet.due else { return Err(None) };
        if at > Instant::now() {
            return Err(Some(at));
        }
        if host != packet.baud_rate {
            packet.bytes.fill(0xff);
        }
        let read: Vec<u8> =
            packet.bytes.drain(..buffer.remaining().min(packet.bytes.len())).collect();
        buffer.put_slice(&read);
        if packet.bytes.is_empty() {
            self.queue.pop_front();
            self.draw_bytes(["<-", "--"], &read, "");
            self.pass_place();
        }
        Ok(())
    }
}

/// The host's end of a link.
pub(crate) struct Link {
    line: ModelLine,
    number: u64,
    baud_rate: Option<BaudRate>,
    timer: Option<Pin<Box<Sleep>>>,
}

impl Connect for ModelLine {
    type Port = TestPort<Link>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let mut state = self.lock();
        state.send_scans();
        if std::mem::take(&mut state.is_unplugged) {
            state.queue.clear();
            state.held = None;
        }
        state.link += 1;
        state.draw("the port is opened");
        let baud_rate = state.sensor.baud_rate.map(|_| BaudRate::B19200);
        Ok(TestPort(Link { line: self.clone(), number: state.link, baud_rate, timer: None }))
    }
}

impl FarEnd for Link {
    fn read(&mut self, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        loop {
            let mut state = self.line.lock();
            if state.link != self.number {
                return Poll::Ready(Ok(()));
            }
            let Err(next) = state.read(self.baud_rate, buffer) else { return Poll::Ready(Ok(())) };
            state.reader = Some(cx.waker().clone());
            drop(state);
            let Some(next) = next else { return Poll::Pending };
            let timer = self.timer.get_or_insert_with(|| Box::pin(sleep_until(next)));
            timer.as_mut().reset(next);
            if timer.as_mut().poll(cx).is_pending() {
                return Poll::Pending;
            }
        }
    }

    fn write(&mut self, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let mut state = self.line.lock();
        if state.link != self.number {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        for byte in bytes {
            if *byte != b'\n' {
                state.input.push(*byte);
            } else if !state.input.is_empty() {
                let line = std::mem::take(&mut state.input);
                state.receive(&line, self.baud_rate);
                state.pass_place();
            }
        }
        let reader = state.reader.take();
        drop(state);
        reader.into_iter().for_each(Waker::wake);
        Poll::Ready(Ok(bytes.len()))
    }

    fn baud_rate(&self) -> Option<BaudRate> {
        self.baud_rate
    }

    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.baud_rate = self.baud_rate.map(|_| baud_rate);
        Ok(())
    }
}
