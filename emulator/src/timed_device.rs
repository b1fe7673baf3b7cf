//! [`TimedDevice`]: the sensor in time. Decides when a command has arrived, when it
//! is served, when its reply is on the line, and what happens without a command.
//!
//! Does no I/O and reads no clock: you pass the time to each call.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::faults::{Aftermath, Delivery, Fault, FaultInjector, Faults};
use super::journal::{Journal, SentScan};
use super::models::Model;
use super::motor::Motor;
use super::playback::{NextReply, Playback};
use super::scip::{
    ArrivedCommand, Device, Effect, HostCommand, LineBuffer, Mode, scip2_scan, status_only,
};
use super::timing::{DeviceTiming, Pace};
use super::wire::{Transmitter, byte_time, garble};
use super::world::{World, WorldTime};
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
    world: Box<dyn World>,
    /// True if links on USB say that they deliver every byte as sent.
    pub(super) is_intact: bool,
    /// Replies to play in place of the world's.
    pub(super) playback: Option<Playback>,
    timing: DeviceTiming,
    pub(super) motor: Motor,
    powered_at: Instant,
    line: LineBuffer,
    /// When the host's last byte has arrived.
    receiving_until: Instant,
    waiting: VecDeque<ArrivedCommand>,
    /// When the sensor has finished its latest command.
    busy_until: Instant,
    /// Until when a reply is on its way.
    unanswered_until: Instant,
    /// Sorted by time.
    events: VecDeque<(Instant, TimedEvent)>,
    /// Earliest time of the next streamed scan, in SCIP 2.
    next_stream: Instant,
}

impl fmt::Debug for TimedDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TimedDevice").field("device", &self.device).finish_non_exhaustive()
    }
}

impl TimedDevice {
    pub(super) fn new(
        device: Device,
        world: Box<dyn World>,
        timing: DeviceTiming,
        motor: Motor,
        faults: FaultInjector,
        journal: Journal,
        now: Instant,
    ) -> Self {
        let ready = now + timing.boot;
        Self {
            device,
            journal,
            faults,
            transmitter: Transmitter::new(now),
            is_hung_up: false,
            is_gone: false,
            world,
            is_intact: false,
            playback: None,
            timing,
            motor,
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

    /// Receives `bytes`, sent while the host's end is at `host` baud.
    pub(super) fn receive(&mut self, now: Instant, bytes: &[u8], host: Option<u32>) {
        let own = self.baud_rate();
        let host = host.filter(|_| own.is_some());
        let mut byte_time = match self.timing.instant_line {
            true => Duration::ZERO,
            false => byte_time(host.or(own)),
        };
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
        for &byte in received {
            at += byte_time;
            if at < self.powered_at + self.timing.boot {
                continue;
            }
            if self.line.is_empty() && self.is_answering(at) {
                self.line.mark_overlapping();
            }
            if let Some(arrived) = self.line.push(byte, at, garbled.is_some()) {
                self.journal.record(&arrived);
                if self.waiting.len() < MAX_WAITING {
                    self.waiting.push_back(arrived);
                    self.prepare_playback();
                } else {
                    self.journal.counts.overrun += 1;
                }
            }
        }
    }

    /// Sends unsolicited bytes.
    pub(super) fn send_unasked(&mut self, now: Instant, bytes: Vec<u8>) {
        self.transmitter.send(now, bytes, self.baud_rate(), None);
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

    /// Cuts the power and restores it at once.
    pub(super) fn power_cycle(&mut self, now: Instant) {
        self.device.power_up();
        self.journal.counts.resets += 1;
        self.transmitter.cut(now);
        self.powered_at = now;
        self.motor.restart(now);
        self.line = LineBuffer::default();
        self.receiving_until = now;
        self.waiting.clear();
        self.busy_until = now + self.timing.boot;
        self.unanswered_until = now;
        self.events.clear();
        self.next_stream = self.busy_until;
    }

    /// Pulls the cable: bytes on it are lost, both ways.
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
        self.faults.replace(faults);
    }

    /// Sensor's baud rate in bits per second, or `None` on USB.
    fn baud_rate(&self) -> Option<u32> {
        self.device.baud_rate.map(u32::from)
    }

    fn next_action(&self) -> Option<(Instant, NextAction)> {
        let event = self.events.front().map(|(at, _)| (*at, NextAction::HandleEvent));
        let (mut serve, mut stream) = (None, None);
        if !self.transmitter.is_full() {
            let first = self.waiting.front();
            serve = first.map(|arrived| (self.serve_at(arrived), NextAction::ServeCommand));
            if self.device.mode == Mode::Scip2Streaming {
                let at = self.motor.next_end(self.next_stream);
                stream = Some((at, NextAction::StreamScan));
            }
        }
        // Of two events at the same time, the first in this list wins.
        event.into_iter().chain(serve).chain(stream).min_by_key(|(at, _)| *at)
    }

    /// Returns true if a command that arrived before `at` is unanswered at that time.
    fn is_answering(&self, at: Instant) -> bool {
        at < self.unanswered_until
            || self.waiting.iter().any(|waiting| waiting.command != HostCommand::Empty)
    }

    fn serve_at(&self, arrived: &ArrivedCommand) -> Instant {
        let free = arrived.at.max(self.busy_until);
        let start = self.timing.serve_at(&self.motor, free);
        match self.next_reply(&arrived.command, start) {
            NextReply::At(due) => due,
            NextReply::NotScripted | NextReply::TooEarly | NextReply::End => start,
        }
    }

    fn prepare_playback(&mut self) {
        if let Some(playback) = &mut self.playback {
            playback.script.prepare();
        }
    }

    /// Answer of the script to a command.
    fn next_reply(&self, command: &HostCommand, at: Instant) -> NextReply {
        // With the laser off, the sensor refuses `G`, whatever the script has.
        let playback = self.playback.as_ref().filter(|_| self.device.is_laser_on);
        playback.map_or(NextReply::NotScripted, |playback| playback.next_reply(command, at))
    }

    fn world_time(&self, at: Instant) -> WorldTime {
        let revolution = self.motor.finished(at).saturating_sub(1);
        let (begin, end) = (self.motor.end(revolution), self.motor.end(revolution + 1));
        let (at, period) = (end.duration_since(self.powered_at), end.duration_since(begin));
        let geometry = Model::Urg04lx.geometry(false);
        WorldTime { revolution, request: self.journal.counts.scans, at, period, geometry }
    }

    fn handle_event(&mut self, at: Instant) {
        match self.events.pop_front() {
            Some((_, TimedEvent::BaudRate(baud_rate))) => {
                self.device.baud_rate = Some(baud_rate);
                if self.timing.stray_byte {
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

    fn serve_command(&mut self, at: Instant) {
        let Some(command) = self.waiting.pop_front() else { return };
        self.busy_until = at;
        if !self.device.answers(&command.command) {
            return;
        }
        self.prepare_playback();
        match self.next_reply(&command.command, at) {
            NextReply::NotScripted | NextReply::At(_) => {}
            NextReply::TooEarly => return,
            NextReply::End => {
                (self.is_hung_up, self.is_gone) = (true, true);
                return;
            }
        }
        let (faults, mut random) = self.faults.draw();
        self.journal.counts.replies += 1;
        if faults.contains(&Fault::CommandLost) {
            return;
        }
        let (reply, effect) = self.execute(at, &command, &faults);

        let mut duration = byte_time(self.baud_rate()) * reply.len() as u32;
        let mut at = at;
        if effect == Effect::LaserOn && self.timing.pace == Pace::PerRevolution {
            at += self.motor.period();
        }
        let mut delivery = Delivery::new(reply);
        if self.timing.instant_line {
            (duration, delivery.byte_time) = (Duration::ZERO, Some(Duration::ZERO));
        }
        for fault in faults {
            delivery.apply(fault, &mut random);
        }
        let start = self.deliver(self.timing.frame_at(self.powered_at, at), delivery);

        // A late reply is delayed on its way, which does not keep the sensor busy.
        self.busy_until = at + duration;
        self.unanswered_until = start + duration;
        if let Effect::BaudRate(baud_rate) = effect {
            let change = (at + self.motor.period()).max(self.transmitter.free());
            self.schedule(change, TimedEvent::BaudRate(baud_rate));
            self.busy_until = change;
        }
    }

    fn execute(
        &mut self,
        at: Instant,
        command: &ArrivedCommand,
        faults: &[Fault],
    ) -> (Vec<u8>, Effect) {
        let refused = faults.iter().find_map(|fault| match fault {
            Fault::Status(status) => Some(*status),
            _ => None,
        });
        if let Some(status) = refused {
            return (status_only(&command.bytes, &[status]), Effect::None);
        }
        let time = self.world_time(at);
        let next_reply = self.next_reply(&command.command, at);
        let (reply, effect) = if let Some(playback) = &mut self.playback {
            if matches!(next_reply, NextReply::At(_))
                && let Some(reply) = playback.advance(&command.bytes, at)
            {
                return (reply, Effect::None);
            }
            let measure = |values: &mut _| playback.script.measure(values);
            self.device.execute(&command.bytes, &command.command, measure)
        } else {
            let measure = |values: &mut _| self.world.measure(time, values);
            self.device.execute(&command.bytes, &command.command, measure)
        };
        if effect == Effect::Scan {
            let revolution_end = self.powered_at + time.at;
            self.journal.record_scan(SentScan { requested_at: command.at, revolution_end, time });
        }
        (reply, effect)
    }

    /// Puts a reply on the line, and returns the time of its first bit.
    fn deliver(&mut self, at: Instant, mut delivery: Delivery) -> Instant {
        let mut at = at + delivery.delay;
        let start = self.transmitter.free().max(at);
        for (pause, bytes) in delivery.take_parts() {
            at = self.transmitter.free().max(at) + pause;
            self.transmitter.send(at, bytes, self.baud_rate(), delivery.byte_time);
        }
        let end = self.transmitter.free().max(at);
        match delivery.then {
            Some(Aftermath::Reset) => self.schedule(end, TimedEvent::Reset),
            Some(Aftermath::HangUp) => self.schedule(end, TimedEvent::HangUp),
            Some(Aftermath::Endless(pattern)) => self.transmitter.set_endless(Some(pattern)),
            None => {}
        }
        start
    }

    /// Sends an unsolicited scan, as in SCIP 2.
    fn stream_scan(&mut self, at: Instant) {
        let time = self.world_time(at);
        let mut values = vec![time.geometry.codes.outside(); time.geometry.steps()];
        self.world.measure(time, &mut values);
        let window = values.get(44..=725).unwrap_or_default();
        let frame = scip2_scan(window, time.at.as_millis() as u64);
        self.send_unasked(at, frame);
        self.next_stream = at;
    }
}
