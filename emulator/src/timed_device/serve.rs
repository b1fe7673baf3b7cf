//! Executes commands and sends scans, each with its faults.

use std::time::Duration;

use tokio::time::Instant;

use super::{TimedDevice, TimedEvent};
use crate::body::{Answer, Effect};
use crate::device::Device;
use crate::faults::{Aftermath, Delivery, Fault};
use crate::journal::SentScan;
use crate::line_buffer::CommandLine;
use crate::models::Model;
use crate::playback::NextReply;
use crate::random::Random;
use crate::scip2::Times;
use crate::timing::Pace;
use crate::wire::byte_time;
use crate::world::WorldTime;
use tokio_scip::BaudRate;

/// While the line is busy, a sensor keeps the scans of this time, and drops those that follow.
const BACKLOG: Duration = Duration::from_millis(200);
/// How long a sensor answers as before after the second `RB`, as in urg_stamped's urg_sim.
const RESTART: Duration = Duration::from_secs(1);

impl TimedDevice {
    pub(super) fn serve_command(&mut self, at: Instant) {
        let Some(line) = self.waiting.pop_front() else { return };
        self.busy_until = at;
        for later in self.waiting.iter_mut().take_while(|later| later.at < at) {
            later.repeated |= later.kind() == line.kind();
        }
        if !self.device.answers(&line) {
            return;
        }
        self.source.prepare();
        match self.source.next_reply(&self.device, &line, at) {
            NextReply::NotScripted | NextReply::At(_) => {}
            NextReply::TooEarly => return,
            NextReply::End => {
                (self.is_hung_up, self.is_gone) = (true, true);
                return;
            }
        }
        let (faults, random) = self.faults.draw(&line.bytes);
        self.journal.counts.replies += 1;
        if faults.contains(&Fault::CommandLost) {
            return;
        }
        let Answer { bytes, effect } = self.execute(at, &line, &faults);
        let duration = self.byte_time() * bytes.len() as u32;
        let at = match effect {
            Effect::Wait(micros) => at + Duration::from_micros(micros),
            _ => at,
        };
        let start = self.send_reply(at, bytes, faults, random);
        // A late reply is delayed on its way, which does not keep the sensor busy.
        self.busy_until = at + duration;
        self.unanswered_until = start + duration;
        self.take_effect(at, effect);
    }

    /// Time that the line needs for a byte.
    fn byte_time(&self) -> Duration {
        self.timing.byte_time.unwrap_or_else(|| byte_time(self.baud_rate()))
    }

    fn execute(&mut self, at: Instant, line: &CommandLine, faults: &[Fault]) -> Answer {
        if let Some(status) = refusal(faults) {
            return self.device.refuse(&line.bytes, status);
        }
        let (time, mut times) = self.times(at, faults);
        if let NextReply::At(_) = self.source.next_reply(&self.device, line, at)
            && let Some(playback) = &mut self.source.playback
            && let Some(reply) = playback.advance(&line.bytes, &mut times)
        {
            return reply.into();
        }
        let before = faults.contains(&Fault::Ignored).then(|| self.device.clone());
        let mut measure = self.source.measure_at(time);
        let mut answer = self.device.execute(line, times, &mut measure);
        drop(measure);
        if answer.effect == Effect::Scan {
            self.record_scan(line.at, time);
        }
        if let Some(before) = before {
            (self.device, answer.effect) = (before, Effect::None);
        }
        answer
    }

    /// Does what a command has set off, once it is answered at `at`.
    fn take_effect(&mut self, at: Instant, effect: Effect) {
        match effect {
            Effect::None | Effect::Wait(_) | Effect::Scan => {}
            // A UTM or UST sends its latest revolution, which must have begun with the laser on.
            Effect::LaserOn => match (self.timing.pace, self.device.body.model) {
                (Pace::PerRevolution, _) => self.scans_from = at + self.motor.period(),
                (_, Model::Urg04lx | Model::Urg04lxUg01) => {}
                _ => self.scans_from = self.motor.next_end(self.motor.next_end(at)),
            },
            Effect::BaudRate(baud_rate) => {
                let change = (at + self.motor.period()).max(self.transmitter.free());
                self.schedule(change, TimedEvent::BaudRate(baud_rate));
                self.busy_until = change;
            }
            Effect::MotorSpeed(percent) => self.motor.slow_down(at, percent),
            // The first scan is of a revolution that begins later.
            Effect::Stream => self.next_stream = self.motor.next_end(at),
            Effect::Reset { all } => {
                self.clock.restart(at);
                if all {
                    self.motor.slow_down(at, 0);
                }
                let rate = self.device.body.baud_rate.filter(|_| all);
                if rate.is_some_and(|rate| rate != BaudRate::B19200) {
                    self.take_effect(at, Effect::BaudRate(BaudRate::B19200));
                }
            }
            Effect::Reboot => self.schedule(self.transmitter.free() + RESTART, TimedEvent::Reset),
        }
    }

    /// Times of a reply, after the jumps of the clock among its faults.
    fn times(&mut self, at: Instant, faults: &[Fault]) -> (WorldTime, Times) {
        for fault in faults {
            if let Fault::ClockJump(milliseconds) = fault {
                self.clock.jump(*milliseconds);
            }
        }
        let time = self.world_time(at);
        let scan = self.clock.read(self.powered_at + time.at_step(0));
        (time, Times { now: at, clock: self.clock.read(at), scan })
    }

    fn record_scan(&mut self, requested_at: Instant, time: WorldTime) {
        let revolution_end = self.powered_at + time.at;
        self.journal.record_scan(SentScan { requested_at, revolution_end, time });
    }

    /// Sends a scan of a stream at the end of its revolution, or when the script has it.
    pub(super) fn stream_scan(&mut self, at: Instant) {
        self.source.prepare();
        match self.source.playback.as_ref().map(|playback| playback.due(at)) {
            Some(None) => {
                (self.is_hung_up, self.is_gone) = (true, true);
                self.next_stream = at + self.motor.period();
                return;
            }
            Some(Some(due)) if due > at => {
                self.next_stream = due;
                return;
            }
            Some(Some(_)) | None => {}
        }
        let Some(stream) = self.device.session.count_down() else { return };
        let (requested_at, skipped) = (stream.requested_at, stream.skipped);
        let echo = stream.echo.clone();
        let (faults, random) = self.faults.draw(&echo);
        self.journal.counts.replies += 1;
        let (time, mut times) = self.times(at, &faults);
        let refusal = refusal(&faults);
        let playback = self.source.playback.as_mut().filter(|_| refusal.is_none());
        let scripted = playback.and_then(|playback| playback.advance(&echo, &mut times));
        let mut measure = self.source.measure_at(time);
        let Device { session, body, .. } = &mut self.device;
        let bytes = session.next_scan(body, times, refusal, scripted, &mut measure);
        drop(measure);
        // A slow line costs whole revolutions.
        let next = match self.source.playback {
            Some(_) => at,
            None => self.motor.end(self.motor.finished(at) + u64::from(skipped)),
        };
        self.next_stream = next.max(at + self.byte_time() * bytes.len() as u32);
        if faults.contains(&Fault::CommandLost) {
            return;
        }
        if refusal.is_none() {
            self.record_scan(requested_at, time);
        }
        self.send_reply(at + self.timing.latency, bytes, faults, random);
        let free = self.transmitter.free();
        if free > self.next_stream + BACKLOG {
            self.next_stream = free;
        }
    }

    /// Puts a reply with its faults on the line, and returns the time of its first bit.
    fn send_reply(
        &mut self,
        at: Instant,
        bytes: Vec<u8>,
        faults: Vec<Fault>,
        mut random: Random,
    ) -> Instant {
        let mut delivery = Delivery::new(bytes);
        delivery.byte_time = self.timing.byte_time;
        for fault in faults {
            delivery.apply(fault, &mut random);
        }
        let mut at = self.timing.frame_at(self.powered_at, at) + delivery.delay;
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
}

/// Status of a reply that a fault refuses.
fn refusal(faults: &[Fault]) -> Option<u8> {
    faults.iter().find_map(|fault| match fault {
        Fault::Status(status) => Some(*status),
        _ => None,
    })
}
