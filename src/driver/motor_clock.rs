//! [`MotorClock`]: estimates when each revolution of the motor ended. Its only input is when
//! replies began to arrive.
//!
//! A sensor begins its reply when a revolution ends. The host reads the first byte later:
//! by up to a millisecond on USB, whose frames are that long, and by 30 ms where a busy
//! host runs the driver late. The motor is steadier than any one of these times. In a
//! capture of a URG-04LX the first bytes lie within 1.3 ms of a line with 99.7605 ms a
//! revolution, 0.36 ms rms, where the firmware line promises 100 ms.
//!
//! # The rule
//!
//! Fit a line to the arrivals: phase and period, by least squares. Two properties of the
//! arrivals shape the fit:
//!
//! - An arrival is late, never early. One below the line weighs [`EARLY_WEIGHT`] times
//!   one above it, so the line runs along the lower edge: for arrivals spread evenly over
//!   a USB frame, at a seventh of the frame.
//! - The period drifts with temperature and supply. The weights fade within [`MEMORY`].
//!   At a drift of 0.1 % an hour the line lags by 40 µs, and one scan in ten seconds
//!   still pins it to 0.3 ms.
//!
//! An arrival above the line by more than the gate is a misfit and changes nothing. The
//! gate is the usual lateness plus the doubt of the line. The sensor answers when the first
//! revolution after a request ends, so a misfit may be late by more than a revolution.
//!
//! # Late replies and jumps
//!
//! On a busy host most replies are misfits, but a jump of the phase also makes misfits:
//!
//! - Misfits of a jump agree, and late replies scatter. A jump needs a row of misfits that
//!   late replies are unlikely to make, given the part of the replies that fit, and several
//!   of them that agree. If at least three in four replies fit, five misfits are enough.
//! - Late replies can agree by chance. So the former line is kept until it is certain that
//!   no reply fits it any more. One that is early for the new line restores it.
//!
//! An arrival that no revolution since its request explains is early, and shows at once
//! that the phase is wrong. Neither a jump nor an early arrival changes the period.
//!
//! # Whether to use the line
//!
//! A wrong line is worse than no line. The arrivals may lie on a line that is not the motor's:
//!
//! - A sensor that answers at once follows its requests. So the driver moves some polls by half of
//!   the time to the next revolution ([`MotorClock::poll_delay`]). If the replies do not move with
//!   them, [`PROVED`] times more often than they do, the line is the motor's. Polls more than a
//!   revolution apart also move by a whole one, which shows a multiple of the period.
//! - An adapter with a latency timer, long frames or a jittery network moves the lower edge. Each
//!   early arrival and each jump casts [`DOUBT`], and so does a start.
//! - A wrong nominal period spreads the arrivals over the revolution. [`MotorClock::trust`]
//!   measures how near to the line they are.
//! - On a very busy host most replies are late, so the part that fits must be [`STEADY`].
//! - If the doubt of the line grows to a quarter of a revolution between two replies,
//!   nothing tells how many revolutions lie between them. The fit then starts again. With
//!   the nominal period this happens below one reply every three seconds.
//!
//! The model in `motor_clock/model.rs` shows what all this is worth.

#[cfg(test)]
#[path = "motor_clock/model.rs"]
mod model;
#[cfg(test)]
#[path = "motor_clock/tests.rs"]
mod tests;

use std::time::Duration;

use tokio::time::Instant;

use crate::stats::MotorStats;

/// Time constant of the fit in seconds.
const MEMORY: f64 = 12.0;
/// Weight of an arrival below the line. An arrival above it has weight 1.
const EARLY_WEIGHT: f64 = 40.0;
/// Doubt of the nominal period, as a standard deviation: 0.3 %. The only motor in a
/// capture is off by 0.24 %.
const NOMINAL_DOUBT: f64 = 0.003;
/// Largest difference between the period and the nominal one. No motor is so far off, so
/// larger differences mean that the arrivals follow something else.
const LARGEST_DIFFERENCE: f64 = 0.02;
/// Usual lateness in seconds until it is measured, and limits of the measured one: the
/// read of a quiet host, and three quarters of a USB frame.
const USUAL_LATENESS: f64 = 0.5e-3;
const LATENESS_LIMITS: (f64, f64) = (0.05e-3, 0.7e-3);
/// Part of the gate that does not depend on the usual lateness, in seconds.
const LEAST_GATE: f64 = 0.15e-3;
/// Number of replies that must fit before the line counts.
const ENOUGH: u64 = 8;
/// The period counts as known if its error is below 0.01 % at this many standard
/// deviations, as far as the arrivals show. The arrivals of a USB sensor are not independent samples: they step through
/// its frames.
const PERIOD_SIGMAS: f64 = 5.0;
const PERIOD_ERROR: f64 = 1e-4;
/// Least number of misfits in a row that are a jump of the phase. Of these at least
/// [`AGREEING`] must lie within one gate, and at least this part of the share that usually
/// fits.
const JUMP: u8 = 4;
const AGREEING: f64 = 3.0;
const AGREEING_PART: f64 = 0.5;
/// Largest chance that late replies alone make a row of misfits that counts as a jump.
const CHANCE_OF_LATENESS: f64 = 3e-3;
/// Largest chance with which a jump becomes certain.
const CHANCE_OF_A_FALSE_JUMP: f64 = 1e-9;
/// Part of the replies that fit: until it is measured, its largest value, and the value
/// below which the fit starts again. One reply in 20 fits any line by chance.
const USUAL_SHARE: f64 = 0.5;
const MOST_SHARE: f64 = 0.99;
const LEAST_SHARE: f64 = 0.1;
/// Number of replies over which the part is averaged: 25 s at 10 Hz.
const SHARE_REPLIES: f64 = 256.0;
/// Least part of the replies that fit, and least [`MotorClock::trust`], of a line that is used.
const STEADY: f64 = 0.7;
const LEAST_TRUST: f64 = 0.7;
/// Doubt about the line, in replies without another reason for doubt: at the start, after an
/// early arrival or a jump, and the most.
const DOUBT_AT_START: f64 = 64.0;
const DOUBT: f64 = 512.0;
const MOST_DOUBT: f64 = 4.0 * DOUBT;
/// An arrival up to this many seconds below the line is early, not late by nearly a revolution.
/// It exceeds the latency timer of an FTDI adapter, 16 ms.
const EARLY: f64 = 0.018;
/// An arrival nearer to the line than this is no reason for doubt: two USB frames of 1 ms.
const NEAR_LINE: f64 = 2e-3;
/// Two misfits in a row rest on the line if late replies make such a row with this chance.
const CHANCE_OF_TWO: f64 = 0.05;
/// A misfit is of the line only if late replies come more often than once in this many seconds.
const RARE: f64 = 30.0;
/// Part of the wait for the end of a revolution by which a poll moves. Least move that tells, in
/// seconds: more than a latency timer of 16 ms can hide. A reply follows within [`FOLLOWS`].
const MOVED_PART: f64 = 0.5;
const LEAST_MOVE: f64 = 0.024;
const FOLLOWS: f64 = 0.004;
/// Number of moved replies that prove a line, less those that speak against it.
const PROVED: i8 = 12;
/// Largest number of polls to move. Each costs up to one and a half revolutions.
const MOST_MOVES: u8 = 40;
/// Least duration of a line whose period is known, in seconds. Frames of 16 ms that nothing shows
/// then bend it by less than 0.1 %.
const LEAST_DURATION: f64 = 20.0;

/// What is known of the revolution that a reply shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Revolution {
    /// Time from the end of the revolution on the line to the arrival of the reply.
    pub(crate) lateness: Option<Duration>,
    /// Duration of a revolution, once it is known.
    pub(crate) period: Option<Duration>,
}

/// Misfits since the latest fitting reply.
#[derive(Debug, Clone, Copy)]
struct Misfits {
    in_a_row: u8,
    /// Chance that late replies alone make such a row.
    chance: f64,
    agreeing: u8,
    /// Smallest lag behind the line of the agreeing misfits, in seconds.
    lag: f64,
    /// The same chance, of the row since the latest agreeing misfit.
    chance_since_agreeing: f64,
}

impl Misfits {
    const NONE: Self = Self {
        in_a_row: 0,
        chance: 1.0,
        agreeing: 0,
        lag: f64::INFINITY,
        chance_since_agreeing: 1.0,
    };
}

/// Line that the latest jump has replaced.
#[derive(Debug, Clone, Copy)]
struct ReplacedLine {
    /// Time from this line to the one that replaced it, in seconds.
    lag: f64,
    /// Weight of its phase.
    weight: f64,
    /// Chance that all replies since the latest one that fitted it were late.
    chance: f64,
}

/// Sums of [`MotorClock`], and their determinant, which is the same from any point.
#[derive(Debug, Clone, Copy)]
struct Moments {
    sums: [f64; 3],
    determinant: f64,
}

/// Line through the ends of revolutions. Its times are in seconds from `origin`.
#[derive(Debug, Clone)]
pub(crate) struct MotorClock {
    origin: Instant,
    /// Seconds per revolution: from the firmware line, and as fitted.
    nominal: f64,
    period: f64,
    /// The fitted period, while it is known.
    known_period: Option<Duration>,
    /// End of the latest revolution on the line, if there is one.
    latest: Option<f64>,
    /// Sums of `w`, `w x` and `w x²` over all replies, with their weights `w` and their
    /// distances `x` from `latest` in revolutions.
    sums: [f64; 3],
    /// Mean lateness of fitting replies, in seconds.
    lateness: f64,
    /// Number of fitting replies since the fit started: in all, and before the latest jump.
    fitting: u64,
    before_jump: u64,
    /// Times of the latest request and arrival, and revolutions between the latest arrivals.
    exchange: (f64, f64),
    turns: [f64; 2],
    /// Number of replies that did not follow a moved poll, less those that did.
    proof: i8,
    is_proved: bool,
    /// True if the latest poll was moved.
    is_moved: bool,
    /// Number of polls moved so far.
    moves: u8,
    /// 1 if all recent replies were on the line, -1 if all were opposite to it.
    trust: f64,
    /// Number of replies until the line is used.
    doubt: f64,
    /// When the line began.
    since: f64,
    /// Part of the replies that fit.
    share: f64,
    counted: f64,
    misfits: Misfits,
    /// Line before the latest jump, until the jump is certain.
    replaced: Option<ReplacedLine>,
    jumps: u64,
}

impl MotorClock {
    /// Creates a clock of a motor whose revolution nominally takes this long.
    pub(crate) fn new(nominal: Duration) -> Self {
        let nominal = nominal.as_secs_f64();
        let origin = Instant::now();
        Self {
            origin,
            nominal,
            period: nominal,
            known_period: None,
            latest: None,
            sums: [0.0; 3],
            lateness: USUAL_LATENESS,
            fitting: 0,
            before_jump: 0,
            exchange: (0.0, 0.0),
            proof: 0,
            is_proved: false,
            is_moved: false,
            moves: 0,
            trust: LEAST_TRUST,
            doubt: DOUBT_AT_START,
            since: 0.0,
            turns: [0.0; 2],
            share: USUAL_SHARE,
            counted: ENOUGH as f64,
            misfits: Misfits::NONE,
            replaced: None,
            jumps: 0,
        }
    }

    /// Adds a reply whose first byte arrived at `arrived`. Returns when the revolution
    /// that it shows ended, which is never later than `arrived`.
    pub(crate) fn observe(&mut self, requested: Instant, arrived: Instant) -> Revolution {
        let arrived = self.seconds(arrived);
        self.compare(requested, arrived);
        self.add(requested, arrived)
    }

    /// How much later than planned to send the next poll, so that its reply shows whether
    /// replies follow the motor or their requests.
    pub(crate) fn poll_delay(&mut self, planned: Instant) -> Duration {
        let Some(latest) = self.latest else { return Duration::ZERO };
        let was_moved = std::mem::take(&mut self.is_moved);
        if self.fitting < ENOUGH || self.proof.abs() >= PROVED || was_moved {
            return Duration::ZERO;
        }
        let since = self.seconds(planned) - latest;
        let wait = (since / self.period).ceil() * self.period - since;
        if MOVED_PART * wait < 1.1 * LEAST_MOVE {
            return Duration::ZERO;
        }
        if self.moves == MOST_MOVES {
            return Duration::ZERO;
        }
        self.moves += 1;
        self.is_moved = true;
        let more = if self.skips_revolutions() { self.period } else { 0.0 };
        duration(MOVED_PART * wait + more)
    }

    /// Compares how far request and reply moved within the revolution since the ones before. A
    /// sensor that answers at once moves both by the same time.
    fn compare(&mut self, requested: Instant, arrived: f64) {
        let (before, answered) = self.exchange;
        self.exchange.1 = arrived;
        self.turns = [self.turns[1], (arrived - answered) / self.period];
        if self.is_proved {
            return;
        }
        let requested = self.seconds(requested);
        self.exchange.0 = requested;
        let moved = part((requested - before) / self.period);
        if moved.abs() * self.period > LEAST_MOVE {
            let followed = part((arrived - answered) / self.period);
            let is_near = |part: f64| part.abs() * self.period < FOLLOWS;
            let vote = match () {
                () if is_near(followed) => 1,
                () if is_near(part(followed - moved)) => -2,
                () if self.skips_revolutions() => -1,
                () => 0,
            };
            self.proof = (self.proof + vote).clamp(-PROVED, PROVED);
            self.is_proved = self.proof == PROVED;
        }
    }

    /// Returns true if some recent replies were more than a revolution apart.
    fn skips_revolutions(&self) -> bool {
        let [before, latest] = self.turns;
        before + latest > 3.0
    }

    fn add(&mut self, requested: Instant, arrived: f64) -> Revolution {
        let Some(latest) = self.latest else { return self.start(arrived) };
        let since = arrived - latest;
        let turns = (since / self.period).round();
        let lag = since - turns * self.period;
        let end = latest + turns * self.period;
        let moments = self.moments(since, turns);
        let gate = self.gate(moments);
        // Not a number if rounding has made the determinant negative.
        if gate.is_nan() || gate >= self.period / 4.0 {
            return self.start(arrived);
        }
        let is_early = lag < -gate && lag > -EARLY;
        let is_far = lag.abs() > gate.max(NEAR_LINE);
        self.trust += (1.0 - 4.0 * (lag / self.period).abs() - self.trust) / 32.0;
        match () {
            () if !is_far && self.doubt <= 0.0 => {}
            () if is_early && is_far => self.add_doubt(),
            // A busy host, where a reply that is nearly a revolution late seems early.
            () if lag.abs() > EARLY => self.doubt = (self.doubt - 16.0).max(0.0),
            () if is_far && self.doubt > 0.0 => self.doubt += 2.0,
            () => self.doubt = (self.doubt - 1.0).max(0.0),
        }
        if lag.abs() <= gate {
            self.fit(moments, end, lag, arrived)
        } else if lag > 0.0 {
            self.misfit(requested, end, lag, gate, arrived)
        } else {
            let found = self.misfit(requested, end - self.period, lag + self.period, gate, arrived);
            if is_early { self.at_arrival() } else { found }
        }
    }

    /// What is known about the motor, once there is a line.
    pub(crate) fn stats(&self) -> Option<MotorStats> {
        self.has_line().then(|| MotorStats {
            revolution: self.known_period.filter(|_| self.is_known()),
            lateness: duration(self.lateness),
            jumps: self.jumps,
        })
    }

    /// Seconds from `origin`.
    fn seconds(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.origin).as_secs_f64()
    }

    /// The sums, faded after `since`, with their distances from a point that is `turns`
    /// revolutions ahead.
    fn moments(&self, since: f64, turns: f64) -> Moments {
        let fade = 1.0 / (1.0 + since.max(0.0) / MEMORY);
        let [w, wx, wxx] = self.sums.map(|sum| sum * fade);
        let determinant = w * wxx - wx * wx;
        let ahead = wx - turns * w;
        Moments { sums: [w, ahead, wxx - turns * (wx + ahead)], determinant }
    }

    /// An arrival further from the line than this does not fit.
    fn gate(&self, Moments { sums: [.., wxx], determinant }: Moments) -> f64 {
        let doubt = self.lateness * (wxx / determinant).sqrt();
        2.5 * self.lateness + LEAST_GATE + 3.0 * doubt
    }

    /// Adds a reply `lag` behind `end`, the end of a revolution on the line.
    fn fit(&mut self, moments: Moments, end: f64, lag: f64, arrived: f64) -> Revolution {
        self.misfits = Misfits::NONE;
        self.update_share(MOST_SHARE);
        self.fitting += 1;
        // While the period is unknown, an early arrival says nothing about the edge.
        let weight = match self.fitting {
            _ if lag >= 0.0 => 1.0,
            ..=ENOUGH => 1.0,
            _ => EARLY_WEIGHT,
        };
        let [w, wx, wxx] = moments.sums;
        let determinant = moments.determinant + weight * wxx;
        let gain = weight * lag / determinant;
        self.sums = [w + weight, wx, wxx];
        let (least, most) = LATENESS_LIMITS;
        self.lateness = (self.lateness + (lag.abs() - self.lateness) / 32.0).clamp(least, most);
        self.period -= wx * gain;
        if (self.period - self.nominal).abs() > LARGEST_DIFFERENCE * self.nominal {
            return self.start(arrived);
        }
        let end = end + wxx * gain;
        self.latest = Some(end);
        self.judge_period(determinant);
        self.on_line(end, arrived)
    }

    /// Judges a reply `lag` after `end`, which is late unless the phase has changed.
    fn misfit(
        &mut self,
        requested: Instant,
        end: f64,
        lag: f64,
        gate: f64,
        arrived: f64,
    ) -> Revolution {
        let requested_at = self.seconds(requested);
        if end < requested_at {
            return self.early(requested, arrived);
        }
        let is_ambiguous = end - requested_at >= self.period;
        self.update_share(0.0);
        if self.share < LEAST_SHARE {
            self.add_doubt();
            return self.start(arrived);
        }
        let late = self.chance_of_lateness();
        let is_rare = self.turns[1] * self.period > RARE * late;
        let misfits = &mut self.misfits;
        misfits.in_a_row = misfits.in_a_row.saturating_add(1);
        misfits.chance *= late;
        misfits.chance_since_agreeing *= late;
        if (lag - misfits.lag).abs() <= gate {
            misfits.lag = misfits.lag.min(lag);
            misfits.agreeing += 1;
            misfits.chance_since_agreeing = 1.0;
        } else if lag < misfits.lag || misfits.chance_since_agreeing < CHANCE_OF_LATENESS {
            (misfits.lag, misfits.agreeing, misfits.chance_since_agreeing) = (lag, 1, 1.0);
        }
        let Misfits { in_a_row, chance, agreeing, lag, .. } = *misfits;
        if in_a_row < JUMP || chance >= CHANCE_OF_LATENESS {
            if is_ambiguous || is_rare || (in_a_row > 1 && chance < CHANCE_OF_TWO) {
                self.at_arrival()
            } else {
                self.on_line(end, arrived)
            }
        } else if !self.has_line() || (self.is_host_busy() && self.known_period.is_none()) {
            self.add_doubt();
            self.start(arrived)
        } else if f64::from(agreeing) >= self.fewest_agreeing(in_a_row) {
            let [weight, ..] = self.sums;
            self.replaced = Some(ReplacedLine { lag, weight, chance });
            // The agreeing ones were not late.
            self.share = (self.share + f64::from(agreeing) / self.counted).min(MOST_SHARE);
            let end = end + lag;
            if lag > NEAR_LINE {
                self.add_doubt();
            }
            self.set_phase(end, f64::from(agreeing));
            self.at_arrival()
        } else {
            self.at_arrival()
        }
    }

    /// Updates the part of the replies that fit. `fits` is 0 for a reply that does not fit.
    fn update_share(&mut self, fits: f64) {
        self.counted = (self.counted + 1.0).min(SHARE_REPLIES);
        self.share += (fits - self.share) / self.counted;
        let Some(mut replaced) = self.replaced else { return };
        replaced.chance *= self.chance_of_lateness();
        let is_certain = replaced.chance < CHANCE_OF_A_FALSE_JUMP;
        self.jumps += u64::from(is_certain);
        self.replaced = (!is_certain).then_some(replaced);
    }

    fn fewest_agreeing(&self, misfits: u8) -> f64 {
        (AGREEING_PART * self.share * f64::from(misfits)).max(AGREEING)
    }

    /// Returns true if most replies are late.
    fn is_host_busy(&self) -> bool {
        self.share < 0.5
    }

    /// Chance that a reply is late. On a busy host part of the replies that fit are late, too.
    fn chance_of_lateness(&self) -> f64 {
        1.0 - self.share * self.share.sqrt()
    }

    /// Corrects a line that an arrival shows to be late.
    fn early(&mut self, requested: Instant, arrived: f64) -> Revolution {
        if let (Some(replaced), Some(latest)) = (self.replaced.take(), self.latest) {
            // The replies that seemed to show a jump were late.
            self.set_phase(latest - replaced.lag, replaced.weight);
            return self.add(requested, arrived);
        }
        // A second early arrival this soon means that the period is wrong, too.
        self.add_doubt();
        if self.fitting - self.before_jump < ENOUGH {
            return self.start(arrived);
        }
        self.jumps += 1;
        self.set_phase(arrived, 1.0);
        self.at_arrival()
    }

    /// Starts the fit again with one arrival and the nominal period.
    fn start(&mut self, arrived: f64) -> Revolution {
        self.period = self.nominal;
        self.lateness = USUAL_LATENESS;
        self.fitting = 0;
        self.trust = LEAST_TRUST;
        (self.share, self.counted) = (USUAL_SHARE, ENOUGH as f64);
        self.replaced = None;
        self.sums = [0.0; 3];
        self.set_phase(arrived, 1.0);
        self.at_arrival()
    }

    /// Moves the line to a new phase, and keeps the fitted period.
    fn set_phase(&mut self, end: f64, weight: f64) {
        let [w, wx, wxx] = self.sums;
        let known = if w > 0.0 { wxx - wx * wx / w } else { 0.0 };
        let doubt = NOMINAL_DOUBT * self.nominal / USUAL_LATENESS;
        self.sums = [weight, 0.0, known.max(1.0 / (doubt * doubt))];
        self.latest = Some(end);
        self.before_jump = self.fitting;
        self.since = end;
        self.misfits = Misfits::NONE;
        let [w, _, wxx] = self.sums;
        self.judge_period(w * wxx);
    }

    fn add_doubt(&mut self) {
        self.doubt = (self.doubt + DOUBT).min(MOST_DOUBT);
    }

    fn has_line(&self) -> bool {
        self.is_proved && self.fitting >= ENOUGH
    }

    /// Returns true if stamps rest on the line.
    fn is_known(&self) -> bool {
        self.has_line() && self.trust > LEAST_TRUST && self.doubt <= 0.0 && self.share >= STEADY
    }

    /// Decides whether the period is known, after a change of the line.
    fn judge_period(&mut self, determinant: f64) {
        let [w, ..] = self.sums;
        let sigmas = PERIOD_SIGMAS * self.lateness;
        let error = PERIOD_ERROR * self.period;
        // Both sides squared, which saves the square root of the variance.
        let lasted = self.latest.map_or(0.0, |latest| latest - self.since);
        let is_known = self.is_known()
            && lasted > LEAST_DURATION
            && sigmas * sigmas * w < error * error * determinant;
        self.known_period = is_known.then(|| duration(self.period));
    }

    fn on_line(&self, end: f64, arrived: f64) -> Revolution {
        if !self.is_known() {
            return Revolution::default();
        }
        Revolution { lateness: Some(duration(arrived - end)), period: self.known_period }
    }

    fn at_arrival(&self) -> Revolution {
        Revolution { lateness: None, period: self.known_period.filter(|_| self.is_known()) }
    }
}

/// Part of a revolution, from -0.5 to 0.5.
fn part(turns: f64) -> f64 {
    turns - turns.round()
}

/// Duration of these seconds, or zero if they are negative.
fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}
