//! [`TimedDevice`]: the sensor in time. Decides when a command has arrived, when it
//! is served, when its reply is on the line, and what happens without a command.
//!
//! Does no I/O and reads no clock: you pass the time to each call. `serve` executes commands.

mod serve;

use std::collections::VecDeque;
use std::fmt;

use tokio::time::Instant;

use super::clock::Clock;
use super::device::{Device, Mode};
use super::faults::{FaultInjector, Faults};
use super::journal::Journal;
use super::line_buffer::{CommandLine, LineBuffer};
use super::motor::Motor;
use super::playback::{NextReply, Source};
use super::timing::DeviceTiming;
use super::wire::{Transmitter, byte_time, garble};
use super::world::WorldTime;
use tokio_scip::BaudRate;

/// Number of commands that wait to be served; further ones are dropped. The input buffer
/// of a real sensor is small, too.
const MAX_WAITING: usize = 32;

/// Change that happens at a set time, without a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TimedEvent {
    BaudRate(BaudRate),
    Reset,
    HangUp,
}

/// What the sensor does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum NextAction {
    HandleEvent,
    ServeCommand,
    StreamScan,
}

pub(super) struct TimedDevice {
    pub(super) device: Device,
    pub(super) journal: Journal,
    pub(super) faults: FaultInjector,
    pub(super) transmitter: Transmitter,
    /// True if a fault, or the script's end, has hung up the link.
    pub(super) is_hung_up: bool,
    /// True if the script has ended, so that the sensor never comes back.
    pub(super) is_gone: bool,
    pub(super) source: Source,
    timing: DeviceTiming,
    pub(super) motor: Motor,
    pub(super) clock: Clock,
    powered_at: Instant,
    pub(super) line: LineBuffer,
    /// When the host's last byte has arrived.
    receiving_until: Instant,
    waiting: VecDeque<CommandLine>,
    /// When the sensor has finished its latest command.
    busy_until: Instant,
    /// Until when a reply is on its way.
    unanswered_until: Instant,
    /// Sorted by time.
    events: VecDeque<(Instant, TimedEvent)>,
    /// The next scan of a stream is of the revolution that ends after this time. A script sends it at
    /// this time, if it is due.
    next_stream: Instant,
    /// A scan comes at the end of a revolution after this time.
    scans_from: Instant,
}

impl fmt::Debug for TimedDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TimedDevice").field("device", &self.device).finish_non_exhaustive()
    }
}

impl TimedDevice {
    pub(super) fn new(
        device: Device,
        source: Source,
        timing: DeviceTiming,
        (motor, clock): (Motor, Clock),
        faults: FaultInjector,
        journal: Journal,
        now: Instant,
    ) -> Self {
        let ready = now + timing.boot;
        let high_water = device.body.model.buffered_bytes();
        Self {
            device,
            journal,
            faults,
            transmitter: Transmitter::new(now, high_water),
            is_hung_up: false,
            is_gone: false,
            source,
            timing,
            motor,
            clock,
            powered_at: now,
            line: LineBuffer::default(),
            receiving_until: now,
            waiting: VecDeque::new(),
            busy_until: ready,
            unanswered_until: now,
            events: VecDeque::new(),
            next_stream: ready,
            scans_from: ready,
        }
    }

    /// Receives `bytes`, sent while the host's end is at `host` baud.
    pub(super) fn receive(&mut self, now: Instant, bytes: &[u8], host: Option<u32>) {
        let own = self.baud_rate();
        let host = host.filter(|_| own.is_some());
        let mut byte_time = self.timing.byte_time.unwrap_or_else(|| byte_time(host.or(own)));
        let start = self.receiving_until.max(now);
        self.receiving_until = start + byte_time * bytes.len() as u32;
        let garbled = match (host, own) {
            (Some(host), Some(own)) if host != own => Some(garble(bytes, host, own)),
            _ => None,
        };
        let received = garbled.as_deref().unwrap_or(bytes);
        if garbled.is_some() {
            byte_time = (self.receiving_until - start) / received.len().max(1) as u32;
        }
        let mut at = start;
        let next = received.iter().skip(1).map(Some).chain([None]);
        for (&byte, next) in received.iter().zip(next) {
            at += byte_time;
            if at < self.powered_at + self.timing.boot {
                continue;
            }
            if (byte, next) == (b'\r', Some(&b'\n')) && self.device.body.model.is_on_ethernet() {
                // The LF ends the line: clients that send both work with a UST.
                continue;
            }
            let is_answering = self.is_answering(at);
            if let Some(arrived) = self.line.push(byte, at, garbled.is_some(), is_answering) {
                self.journal.record(&arrived, self.device.verdict(&arrived));
                if self.waiting.len() < MAX_WAITING {
                    self.waiting.push_back(arrived);
                    self.source.prepare();
                } else {
                    self.journal.counts.overrun += 1;
                }
            }
        }
    }

    /// Sends unsolicited bytes.
    pub(super) fn send_unasked(&mut self, now: Instant, bytes: Vec<u8>) {
        self.transmitter.send(now, bytes, self.baud_rate(), self.timing.byte_time);
    }

    /// Does everything that is due until `now`. The host's end of the line is at `host`
    /// baud, or at the sensor's baud rate if `host` is `None`.
    pub(super) fn advance(&mut self, now: Instant, host: Option<u32>) {
        while let Some((at, action)) = self.next_action()
            && at <= now
        {
            self.transmitter.advance(at, self.baud_rate(), host);
            match action {
                NextAction::HandleEvent => self.handle_event(at),
                NextAction::ServeCommand => self.serve_command(at),
                NextAction::StreamScan => self.stream_scan(at),
            }
        }
        if self.transmitter.is_full() {
            // Skips the scans that could not be sent.
            self.next_stream = self.next_stream.max(now);
        }
        self.transmitter.advance(now, self.baud_rate(), host);
    }

    /// When there is next something to do or to read.
    pub(super) fn next_time(&self) -> Option<Instant> {
        let action = self.next_action().map(|(at, _)| at);
        action.into_iter().chain(self.transmitter.next_arrival()).min()
    }

    /// Cuts the power and restores it at once. A sensor on Ethernet loses its connection.
    pub(super) fn power_cycle(&mut self, now: Instant) {
        self.device.power_up();
        self.journal.counts.resets += 1;
        self.transmitter.cut(now);
        self.powered_at = now;
        self.motor.restart(now);
        self.clock.restart(now);
        self.line = LineBuffer::default();
        self.receiving_until = now;
        self.waiting.clear();
        self.busy_until = now + self.timing.boot;
        self.unanswered_until = now;
        self.events.clear();
        self.next_stream = self.busy_until;
        self.scans_from = self.busy_until;
        self.is_hung_up |= self.device.body.model.is_on_ethernet();
    }

    /// Pulls the cable: bytes on it are lost, both ways.
    pub(super) fn unplug(&mut self, now: Instant) {
        self.transmitter.clear(now);
        self.receiving_until = now;
    }

    pub(super) fn set_mode(&mut self, mode: Mode, now: Instant) {
        self.device.set_mode(mode, now);
        self.next_stream = now.max(self.powered_at + self.timing.boot);
    }

    pub(super) fn set_faults(&mut self, faults: Faults) {
        self.transmitter.set_endless(None);
        self.faults.replace(faults);
    }

    /// Sensor's baud rate in bits per second, or `None` on USB.
    fn baud_rate(&self) -> Option<u32> {
        self.device.body.baud_rate.map(u32::from)
    }

    fn next_action(&self) -> Option<(Instant, NextAction)> {
        let event = self.events.front().map(|(at, _)| (*at, NextAction::HandleEvent));
        let (mut serve, mut stream) = (None, None);
        if !self.transmitter.is_full() {
            let first = self.waiting.front();
            serve = first.map(|arrived| (self.serve_at(arrived), NextAction::ServeCommand));
            if self.device.session.stream().is_some() {
                let at = match self.source.playback {
                    Some(_) => self.next_stream,
                    None => self.motor.next_end(self.next_stream),
                };
                stream = Some((at, NextAction::StreamScan));
            }
        }
        // Of two events at the same time, the first in this list wins.
        event.into_iter().chain(serve).chain(stream).min_by_key(|(at, _)| *at)
    }

    /// Returns true if a command that arrived before `at` is unanswered at that time.
    fn is_answering(&self, at: Instant) -> bool {
        at < self.unanswered_until || self.waiting.iter().any(|waiting| !waiting.bytes.is_empty())
    }

    fn serve_at(&self, line: &CommandLine) -> Instant {
        let mut free = line.at.max(self.busy_until);
        if line.asks_for_scan() {
            free = free.max(self.scans_from);
        }
        let start = self.timing.serve_at(&self.motor, free);
        match self.source.next_reply(&self.device, line, start) {
            NextReply::At(due) => due,
            NextReply::NotScripted | NextReply::TooEarly | NextReply::End => start,
        }
    }

    fn world_time(&self, at: Instant) -> WorldTime {
        let revolution = self.motor.finished(at).saturating_sub(1);
        let (begin, end) = (self.motor.end(revolution), self.motor.end(revolution + 1));
        let (at, period) = (end.duration_since(self.powered_at), end.duration_since(begin));
        let geometry = self.device.geometry();
        WorldTime { revolution, request: self.journal.counts.scans, at, period, geometry }
    }

    fn handle_event(&mut self, at: Instant) {
        match self.events.pop_front() {
            Some((_, TimedEvent::BaudRate(baud_rate))) => {
                self.device.body.baud_rate = Some(baud_rate);
                if !self.timing.omits_stray_byte {
                    self.send_unasked(at, vec![0]);
                }
            }
            Some((_, TimedEvent::Reset)) => self.power_cycle(at),
            Some((_, TimedEvent::HangUp)) => self.is_hung_up = true,
            None => {}
        }
    }

    fn schedule(&mut self, at: Instant, event: TimedEvent) {
        let place = self.events.partition_point(|(time, _)| *time <= at);
        self.events.insert(place, (at, event));
    }
}
