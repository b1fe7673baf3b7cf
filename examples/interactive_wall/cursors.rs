//! [`Cursors`]: hands that keep their ids from scan to scan, as TUIO 1.1 sends them
//! (<https://www.tuio.org/?tuio11>, profile `2Dcur`).

use std::iter::once;
use std::time::Duration;

use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType};
use tokio::time::Instant;

use super::Result;
use super::picture::{Spot, distance};

/// A hand is at most this far from where its motion leads, in metres.
const REACH: f64 = 0.35;
/// A hand that was not seen for longer is gone: one scan may miss it.
const LOST: Duration = Duration::from_millis(250);

struct Cursor {
    id: i32,
    seen: Instant,
    /// In metres.
    at: Spot,
    /// In metres per second.
    motion: Spot,
    place: Spot,
    /// In widths and heights of the picture per second.
    velocity: Spot,
    /// Change of the speed, per second.
    acceleration: f64,
}

impl Cursor {
    /// Where it is if its motion has not changed: without that, a hand would take the id of one
    /// right ahead.
    fn expected(&self, now: Instant) -> Spot {
        let seconds = (now - self.seen).as_secs_f64();
        (self.at.0 + seconds * self.motion.0, self.at.1 + seconds * self.motion.1)
    }

    fn move_to(&mut self, (at, place): (Spot, Spot), now: Instant) {
        let seconds = (now - self.seen).as_secs_f64().max(0.001);
        let rate = |to: Spot, from: Spot| ((to.0 - from.0) / seconds, (to.1 - from.1) / seconds);
        let velocity = rate(place, self.place);
        let speed = |velocity| distance(velocity, (0.0, 0.0));
        self.acceleration = (speed(velocity) - speed(self.velocity)) / seconds;
        (self.motion, self.velocity) = (rate(at, self.at), velocity);
        (self.at, self.place, self.seen) = (at, place, now);
    }

    fn message(&self) -> OscPacket {
        let Self { place, velocity, acceleration, .. } = *self;
        let numbers = [place.0, place.1, velocity.0, velocity.1, acceleration];
        let numbers = numbers.map(|number| OscType::Float(number as f32));
        message("set", once(self.id.into()).chain(numbers))
    }
}

#[derive(Default)]
pub(super) struct Cursors {
    cursors: Vec<Cursor>,
    last_id: i32,
    last_frame: i32,
}

impl Cursors {
    /// Moves each cursor to a hand, the closest pairs first. Takes where hands are, in metres and
    /// in the picture.
    pub(super) fn follow(&mut self, mut hands: Vec<(Spot, Spot)>, now: Instant) {
        let mut cursors: Vec<&mut Cursor> = self.cursors.iter_mut().collect();
        loop {
            let ways = cursors.iter().enumerate().flat_map(|(cursor, from)| {
                let hands = hands.iter().enumerate();
                hands.map(move |(hand, to)| (distance(from.expected(now), to.0), cursor, hand))
            });
            let closest = ways.min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, cursor, hand)) = closest.filter(|&(way, ..)| way < REACH) else { break };
            cursors.swap_remove(cursor).move_to(hands.swap_remove(hand), now);
        }
        self.cursors.retain(|cursor| now - cursor.seen < LOST);
        for (at, place) in hands {
            self.last_id = self.last_id.wrapping_add(1);
            let (id, motion, velocity, acceleration) = (self.last_id, (0.0, 0.0), (0.0, 0.0), 0.0);
            self.cursors.push(Cursor { id, seen: now, at, motion, place, velocity, acceleration });
        }
    }

    /// Returns the bundle with the state of all cursors.
    pub(super) fn bundle(&mut self, source: &str) -> Result<Vec<u8>> {
        self.last_frame = self.last_frame.wrapping_add(1);
        let alive = self.cursors.iter().map(|cursor| cursor.id.into());
        let mut content = vec![message("source", [source.into()]), message("alive", alive)];
        content.extend(self.cursors.iter().map(Cursor::message));
        content.push(message("fseq", [self.last_frame.into()]));
        let timetag = OscTime { seconds: 0, fractional: 1 }; // at once
        let bundle = OscPacket::Bundle(OscBundle { timetag, content });
        rosc::encoder::encode(&bundle).map_err(|error| format!("OSC: {error:?}").into())
    }
}

fn message(kind: &str, arguments: impl IntoIterator<Item = OscType>) -> OscPacket {
    let args = once(kind.into()).chain(arguments).collect();
    OscPacket::Message(OscMessage { addr: "/tuio/2Dcur".to_owned(), args })
}
