//! [`FaultInjector`]: decides which faults a reply has.

use std::collections::HashMap;
use std::mem::{Discriminant, discriminant, take};
use std::time::Duration;

use super::{Details, Fault, Faults, Trigger};
use crate::random::Random;
use crate::timing::LONGEST;

/// Draws the faults of one reply after another.
#[derive(Debug)]
pub(crate) struct FaultInjector {
    faults: Faults,
    random: Random,
    next_reply: u64,
    /// Seed if the faults have no seed.
    default_seed: u64,
    /// Number of faults drawn, by variant.
    counts: HashMap<Discriminant<Fault>, u64>,
}

impl FaultInjector {
    pub(crate) fn new(faults: Faults, default_seed: u64) -> Self {
        let random = Random::new(faults.seed.unwrap_or(default_seed));
        Self { faults, random, next_reply: 0, default_seed, counts: HashMap::new() }
    }

    /// Replaces the faults, but keeps the counts.
    pub(crate) fn replace(&mut self, faults: Faults) {
        *self = Self { counts: take(&mut self.counts), ..Self::new(faults, self.default_seed) };
    }

    /// Draws the faults of the next reply, to this command, and a generator for their details.
    pub(crate) fn draw(&mut self, command: &[u8]) -> (Vec<Fault>, Random) {
        // One number for each reply, so that its faults do not depend on the length or
        // the faults of an earlier reply.
        let mut random = Random::new(self.random.next());
        let number = self.next_reply;
        self.next_reply += 1;
        let mut drawn = Vec::new();
        self.faults.scripted.retain(|(trigger, fault)| {
            let applies = match trigger {
                Trigger::EveryReply => true,
                Trigger::Reply(reply) => *reply == number,
                Trigger::Command(start) | Trigger::Once(start) => command.starts_with(start),
            };
            if applies {
                drawn.push(fault.clone());
            }
            !(applies && matches!(trigger, Trigger::Once(_)))
        });
        for (probability, fault) in &self.faults.random {
            if random.fraction() < *probability {
                drawn.push(fault.draw(&mut random));
            }
        }
        for fault in &drawn {
            *self.counts.entry(discriminant(fault)).or_default() += 1;
        }
        (drawn, random)
    }

    /// Number of faults drawn with the variant of `fault`.
    pub(crate) fn count(&self, fault: &Fault) -> u64 {
        self.counts.get(&discriminant(fault)).copied().unwrap_or_default()
    }
}

impl Details {
    fn draw(&self, random: &mut Random) -> Fault {
        let most = match self {
            Self::Fixed(fault) => return fault.clone(),
            Self::UpTo(most) => most,
        };
        let up_to = |most: usize, random: &mut Random| {
            random.below((most as u64).saturating_add(1)) as usize
        };
        let time =
            |most: Duration, random: &mut Random| most.min(LONGEST).mul_f64(random.fraction());
        match *most {
            Fault::Late(longest) => Fault::Late(time(longest, random)),
            Fault::Pause(last, longest) => {
                let pause = time(longest, random);
                Fault::Pause(up_to(last, random), pause)
            }
            Fault::ClockJump(milliseconds) => {
                let longest = Duration::from_millis(milliseconds.unsigned_abs());
                let milliseconds = time(longest, random).as_millis() as i64;
                Fault::ClockJump(if random.below(2) == 0 { milliseconds } else { -milliseconds })
            }
            Fault::Noise(longest) => Fault::Noise(up_to(longest, random)),
            Fault::Reset(last) => Fault::Reset(up_to(last, random)),
            Fault::HangUp(last) => Fault::HangUp(up_to(last, random)),
            _ => most.clone(),
        }
    }
}
