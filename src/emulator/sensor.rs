//! The sensor in time: when a command is in, when it is served, and what
//! happens by itself. No I/O and no clock: it is told the time.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::damage::{Aftermath, Delivery};
use super::device::{Device, Effect, Mode};
use super::encode;
use super::faults::{Fault, Faults, Mishaps};
use super::journal::Journal;
use super::request::{Arrived, LineBuffer, Request};
use super::script::{Cue, Performance};
use super::timing::{Pace, Timing};
use super::transmitter::Transmitter;
use super::wire::{byte_time, garble};
use super::world::{FAR, World, WorldTime};
use crate::BaudRate;

/// Commands that wait to be served. A real sensor's input buffer is small too.
const WAITING: usize = 32;

/// What happens by itself at some time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    Speed(BaudRate),
    Reset,
    HangUp,
}

pub(super) struct Sensor {
    pub(super) device: Device,
    pub(super) journal: Journal,
    pub(super) mishaps: Mishaps,
    pub(super) transmitter: Transmitter,
    /// Whether a fault has hung up the link.
    pub(super) hung_up: bool,
    /// Whether the script has ended: the sensor is gone for good.
    pub(super) gone: bool,
    world: Box<dyn World>,
    /// What it plays instead of looking at the world.
    pub(super) performance: Option<Performance>,
    timing: Timing,
    seed: u64,
    powered_at: Instant,
    line: LineBuffer,
    /// When the host's last byte is through.
    receiving_until: Instant,
    waiting: VecDeque<Arrived>,
    /// Until when a command keeps the sensor busy.
    busy_until: Instant,
    /// Until when a reply is on its way.
    unanswered_until: Instant,
    /// In order of time.
    events: VecDeque<(Instant, Event)>,
    /// When the next scan is streamed, in SCIP 2.
    next_stream: Instant,
}

impl fmt::Debug for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sensor").field("device", &self.device).finish_non_exhaustive()
    }
}

impl Sensor {
    pub(super) fn new(
        device: Device,
        world: Box<dyn World>,
        timing: Timing,
        faults: Faults,
        seed: u64,
        log: usize,
        now: Instant,
    ) -> Self {
        let ready = now + timing.boot;
        Self {
            device,
            journal: Journal::new(log),
            mishaps: Mishaps::new(faults, seed),
            transmitter: Transmitter::new(now),
            hung_up: false,
            gone: false,
            world,
            performance: None,
            timing,
            seed,
            powered_at: now,
            line: LineBuffer::default(),
            receiving_until: now,
            waiting: VecDeque::new(),
            busy_until: ready,
            unanswered_until: now,
            events: VecDeque::new(),
            next_stream: ready,
        }
    }

    /// The host writes `bytes` at `host` bits a second.
    pub(super) fn receive(&mut self, now: Instant, bytes: &[u8], host: Option<u32>) {
        let speed = host.filter(|_| self.device.speed.is_some());
        let own = self.device.speed.map(BaudRate::bits_per_second);
        let mut byte_time = match self.timing.instant_line {
            true => Duration::ZERO,
            false => byte_time(speed.or(own)),
        };
        let start = self.receiving_until.max(now);
        self.receiving_until = start + byte_time * bytes.len() as u32;
        let garbled = match (speed, own) {
            (Some(host), Some(own)) if host != own => Some(garble(bytes, host, own)),
            _ => None,
        };
        let heard = garbled.as_deref().unwrap_or(bytes);
        if garbled.is_some() {
            byte_time = (self.receiving_until - start) / heard.len().max(1) as u32;
        }
        let mut at = start;
        for &byte in heard {
            at += byte_time;
            if at < self.powered_at + self.timing.boot {
                continue;
            }
            if self.line.is_empty() && self.is_answering(at) {
                self.line.overlaps();
            }
            if let Some(arrived) = self.line.push(byte, at, garbled.is_some()) {
                self.journal.record(&arrived);
                if self.waiting.len() < WAITING {
                    self.waiting.push_back(arrived);
                } else {
                    self.journal.counts.overrun += 1;
                }
            }
        }
    }

    /// Sends bytes that nobody has asked for.
    pub(super) fn say(&mut self, now: Instant, bytes: Vec<u8>) {
        let speed = self.device.speed.map(BaudRate::bits_per_second);
        self.transmitter.send(now, bytes, speed, None);
    }

    /// Does all that falls due until `now`; the host's end of the line is at
    /// `host` bits a second, or follows the sensor's.
    pub(super) fn advance(&mut self, now: Instant, host: Option<u32>) {
        while let Some((at, what)) = self.next_doing()
            && at <= now
        {
            let speed = self.device.speed.map(BaudRate::bits_per_second);
            self.transmitter.advance(at, speed, host);
            match what {
                Doing::Event => self.happen(at),
                Doing::Serve => self.serve(at),
                Doing::Stream => self.stream(at),
            }
        }
        if self.transmitter.is_clogged() {
            // Scans that nobody took are not made up for.
            self.next_stream = self.next_stream.max(now);
        }
        let speed = self.device.speed.map(BaudRate::bits_per_second);
        self.transmitter.advance(now, speed, host);
    }

    /// When there is something to do or to read next.
    pub(super) fn next_time(&self) -> Option<Instant> {
        let doing = self.next_doing().map(|(at, _)| at);
        doing.into_iter().chain(self.transmitter.next_arrival()).min()
    }

    /// The power is cut and comes back at once.
    pub(super) fn power_cycle(&mut self, now: Instant) {
        self.device.power_up();
        self.journal.counts.resets += 1;
        self.transmitter.cut(now);
        self.powered_at = now;
        self.line = LineBuffer::default();
        self.receiving_until = now;
        self.waiting.clear();
        self.busy_until = now + self.timing.boot;
        self.unanswered_until = now;
        self.events.clear();
        self.next_stream = self.busy_until;
    }

    /// The cable is pulled: what is on it is gone, both ways.
    pub(super) fn unplug(&mut self, now: Instant) {
        self.transmitter.clear(now);
        self.receiving_until = now;
    }

    pub(super) fn set_mode(&mut self, mode: Mode, now: Instant) {
        self.device.mode = mode;
        self.next_stream = now.max(self.powered_at + self.timing.boot);
    }

    pub(super) fn set_faults(&mut self, faults: Faults) {
        self.transmitter.set_endless(None);
        self.mishaps.replace(faults, self.seed);
    }

    fn next_doing(&self) -> Option<(Instant, Doing)> {
        let event = self.events.front().map(|(at, _)| (*at, Doing::Event));
        let (mut serve, mut stream) = (None, None);
        if !self.transmitter.is_clogged() {
            serve = self.waiting.front().map(|arrived| (self.serve_at(arrived), Doing::Serve));
            if self.device.mode == Mode::Scip2Streaming {
                let at = self.timing.revolution_after(self.powered_at, self.next_stream);
                stream = Some((at, Doing::Stream));
            }
        }
        // Where two fall on the same time, the first one in this list goes first.
        event.into_iter().chain(serve).chain(stream).min_by_key(|(at, _)| *at)
    }

    /// Whether a command that came before `at` waits for the end of its reply.
    fn is_answering(&self, at: Instant) -> bool {
        at < self.unanswered_until
            || self.waiting.iter().any(|waiting| waiting.request != Request::Empty)
    }

    fn serve_at(&self, arrived: &Arrived) -> Instant {
        let free = arrived.at.max(self.busy_until);
        let start = self.timing.serve_at(self.powered_at, free);
        match self.cue(&arrived.request, start) {
            Cue::Reply(due) => due,
            Cue::None | Cue::Silence | Cue::End => start,
        }
    }

    /// What the script has for `request`.
    fn cue(&self, request: &Request, at: Instant) -> Cue {
        // With the laser off `G` is refused, whatever is measured.
        let performance = self.performance.as_ref().filter(|_| self.device.laser);
        performance.map_or(Cue::None, |performance| performance.cue(request, at))
    }

    fn look(&self, at: Instant) -> WorldTime {
        let revolution = self.timing.revolutions_before(self.powered_at, at).saturating_sub(1);
        let at = self.timing.turns(revolution + 1);
        WorldTime { revolution, request: self.journal.counts.scans, at }
    }

    fn happen(&mut self, at: Instant) {
        match self.events.pop_front() {
            Some((_, Event::Speed(speed))) => {
                self.device.speed = Some(speed);
                if self.timing.stray_byte {
                    self.say(at, vec![0]);
                }
            }
            Some((_, Event::Reset)) => self.power_cycle(at),
            Some((_, Event::HangUp)) => self.hung_up = true,
            None => {}
        }
    }

    fn later(&mut self, at: Instant, event: Event) {
        let place = self.events.partition_point(|(time, _)| *time <= at);
        self.events.insert(place, (at, event));
    }

    fn serve(&mut self, at: Instant) {
        let Some(command) = self.waiting.pop_front() else { return };
        self.busy_until = at;
        if !self.device.answers(&command.request) {
            return;
        }
        match self.cue(&command.request, at) {
            Cue::None | Cue::Reply(_) => {}
            Cue::Silence => return,
            Cue::End => {
                (self.hung_up, self.gone) = (true, true);
                return;
            }
        }
        let (faults, mut random) = self.mishaps.draw();
        self.journal.counts.replies += 1;
        if faults.contains(&Fault::CommandLost) {
            return;
        }
        let (reply, effect) = self.execute(at, &command, &faults);

        let speed = self.device.speed.map(BaudRate::bits_per_second);
        let mut whole = byte_time(speed) * reply.len() as u32;
        let mut at = at;
        if effect == Effect::LaserOn && self.timing.pace == Pace::PerRevolution {
            at += self.timing.revolution;
        }
        let mut delivery = Delivery::new(reply);
        if self.timing.instant_line {
            (whole, delivery.byte_time) = (Duration::ZERO, Some(Duration::ZERO));
        }
        for fault in faults {
            delivery.suffer(fault, &mut random);
        }
        let start = self.deliver(at, delivery, speed);

        // A late reply is held up on its way: the sensor goes on meanwhile.
        self.busy_until = at + whole;
        self.unanswered_until = start + whole;
        if let Effect::Speed(speed) = effect {
            let change = (at + self.timing.revolution).max(self.transmitter.free());
            self.later(change, Event::Speed(speed));
            self.busy_until = change;
        }
    }

    fn execute(&mut self, at: Instant, command: &Arrived, faults: &[Fault]) -> (Vec<u8>, Effect) {
        let refused = faults.iter().find_map(|fault| match fault {
            Fault::Status(status) => Some(*status),
            _ => None,
        });
        if let Some(status) = refused {
            return (encode::status_only(&command.bytes, &[status]), Effect::None);
        }
        let look = self.look(at);
        let cue = self.cue(&command.request, at);
        let (reply, effect) = if let Some(performance) = &mut self.performance {
            if matches!(cue, Cue::Reply(_))
                && let Some(reply) = performance.advance(&command.bytes, at)
            {
                return (reply, Effect::None);
            }
            let look = |codes: &mut _| performance.look(codes);
            self.device.serve(&command.bytes, &command.request, look)
        } else {
            let look = |codes: &mut _| self.world.look(look, codes);
            self.device.serve(&command.bytes, &command.request, look)
        };
        self.journal.counts.scans += u64::from(effect == Effect::Scan);
        (reply, effect)
    }

    /// Puts a reply on the line, and gives the time when it starts.
    fn deliver(&mut self, at: Instant, mut delivery: Delivery, speed: Option<u32>) -> Instant {
        let mut at = at + delivery.delay;
        let start = self.transmitter.free().max(at);
        for (pause, bytes) in delivery.parts() {
            at = self.transmitter.free().max(at) + pause;
            self.transmitter.send(at, bytes, speed, delivery.byte_time);
        }
        let end = self.transmitter.free().max(at);
        match delivery.then {
            Some(Aftermath::Reset) => self.later(end, Event::Reset),
            Some(Aftermath::HangUp) => self.later(end, Event::HangUp),
            Some(Aftermath::Endless(pattern)) => self.transmitter.set_endless(Some(pattern)),
            None => {}
        }
        start
    }

    /// Sends a scan unasked, as in SCIP 2.
    fn stream(&mut self, at: Instant) {
        let look = self.look(at);
        let mut codes = [FAR; super::STEPS];
        self.world.look(look, &mut codes);
        let window = codes.get(44..=725).unwrap_or_default();
        let frame = encode::scip2_scan(window, look.at.as_millis() as u64);
        self.say(at, frame);
        self.next_stream = at;
    }
}

/// What is to be done next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Event,
    Serve,
    Stream,
}
