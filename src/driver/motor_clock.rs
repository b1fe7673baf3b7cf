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
//! An arrival farther from the line than the gate is a misfit. The gate is the usual lateness plus
//! the doubt of the line.
//!
//! # Late replies and jumps
//!
//! An arrival above the line by more than the gate is late, and changes nothing. But a jump of
//! the phase also makes misfits. Misfits after a jump agree, and late replies scatter. So misfits vote:
//! [`JUMP`] that agree, beyond those that do not, move the line. The sensor answers when the first
//! revolution after a request ends. An arrival that no revolution since its request explains is
//! early, and moves the line at once. Neither changes the period.
//!
//! # Whether to use the line
//!
//! A wrong line is worse than no line. The arrivals may lie on a line that is not the motor's:
//!
//! - A sensor that answers at once follows its requests. So the driver moves some polls
//!   ([`Revolution::delay`]). If the replies do not move with them, [`PROVED`] times more often
//!   than they do, the line is the motor's. Polls more than a revolution apart also move by up
//!   to two whole ones, which shows a multiple of the period.
//! - An adapter with a latency timer, long frames or a jittery network moves the lower edge. Each
//!   early arrival and each jump casts doubt, and so does a start. Until then misfits add more.
//! - On a very busy host most replies are late, and with a wrong nominal period they spread over the
//!   revolution. So the part that fits must be [`STEADY`].
//! - If the doubt of the line grows to a quarter of a revolution between two replies,
//!   nothing tells how many revolutions lie between them. The fit then starts again. With
//!   the nominal period this happens below one reply every three seconds, and always after
//!   [`LONGEST_GAP`].
//!
//! The model in `motor_clock/model.rs` shows what all this is worth.

// With their paths, because a benchmark includes this file.
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
/// Standard deviation of the nominal period: the only motor in a capture is off by 0.24 %.
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
const ENOUGH: u32 = 8;
/// Number of misfits that agree, beyond those that do not, which are a jump of the phase.
const JUMP: u32 = 5;
/// A misfit rests on the line only if late replies come more often than once in this many seconds:
/// otherwise it may be of a jump.
const RARE: f64 = 30.0;
/// The period counts as known if its error is below 0.01 % at this many standard
/// deviations, as far as the arrivals show. The arrivals of a USB sensor are not independent samples: they step through
/// its frames.
const PERIOD_SIGMAS: f64 = 5.0;
const PERIOD_ERROR: f64 = 1e-4;
/// Least duration of a line whose period is known, in seconds. Frames of 16 ms that nothing shows
/// then bend it by less than 0.1 %.
const LEAST_DURATION: f64 = 20.0;
/// Longest time between two replies of one line, in seconds: a drift of 3 % an hour changes the
/// period by 0.05 % meanwhile.
const LONGEST_GAP: f64 = 60.0;
/// Part of the replies that fit: at the start, its least value for a line that is used, and the
/// value below which the fit starts again. One reply in 20 fits any line by chance.
const USUAL_SHARE: f64 = 0.5;
const STEADY: f64 = 0.7;
const LEAST_SHARE: f64 = 0.1;
/// Number of replies over which the part is averaged.
const SHARE_REPLIES: f64 = 128.0;
/// Number of fitting replies before a line is used: at the start, and after a jump. These add up to
/// [`MOST_DOUBT`], and until then each misfit adds [`DOUBT_BY_MISFIT`]. A move by less than
/// [`EARLY`] casts all: the line may follow frames, and moves again.
const DOUBT_AT_START: u32 = 256;
const DOUBT: u32 = 512;
const DOUBT_BY_MISFIT: u32 = 2;
const MOST_DOUBT: u32 = 4 * DOUBT;
/// An arrival up to this many seconds below the line is early, not late by nearly a revolution.
/// It exceeds the latency timer of an FTDI adapter, 16 ms.
const EARLY: f64 = 0.018;
/// An arrival nearer to the line than this is no reason for doubt: two USB frames of 1 ms.
const NEAR_LINE: f64 = 2e-3;
/// Polls less than a revolution apart move by this part of the latest reply's wait.
const MOVED_PART: f64 = 0.5;
/// Other polls move by these numbers of revolutions, in turn.
const MOVED_TURNS: [f64; 6] = [0.4, 1.6, 2.4, 0.6, 1.4, 2.6];
/// Least move that shows what the reply follows, in seconds. A latency timer of 16 ms hides a smaller
/// one.
const LEAST_MOVE: f64 = 0.024;
/// A reply follows the poll or the motor if it is at most this many seconds from where either puts it.
const FOLLOWS: f64 = 0.004;
/// Number of moved replies that prove a line, less those that speak against it.
const PROVED: i8 = 12;
/// Largest number of polls to move. Each costs up to three revolutions.
const MOST_MOVES: u8 = 40;

/// What a reply shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Revolution {
    /// Time from the end of the revolution on the line to the arrival of the reply.
    pub(crate) lateness: Option<Duration>,
    /// Duration of a revolution, once it is known.
    pub(crate) period: Option<Duration>,
    /// How much later than due to send the next poll: its reply tells what replies follow.
    pub(crate) delay: Duration,
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
    /// When the line began.
    since: f64,
    /// Sums of `w`, `w x` and `w x²` over all replies, with their weights `w` and their
    /// distances `x` from `latest` in revolutions.
    sums: [f64; 3],
    /// Mean lateness of fitting replies, in seconds.
    lateness: f64,
    /// Number of replies that fit the line.
    fitting: u32,
    /// Part of the recent replies that fit.
    share: f64,
    counted: f64,
    /// Number of fitting replies until the line is used.
    doubt: u32,
    misfits: Misfits,
    jumps: u64,
    proof: Proof,
}

/// Misfits since the latest fitting reply, and the lag behind the line, in seconds, on which most
/// of them agree (the majority vote of Boyer and Moore).
#[derive(Debug, Clone, Copy, Default)]
struct Misfits {
    in_a_row: u32,
    lag: f64,
    votes: u32,
}

/// Whether replies follow the motor or their requests.
#[derive(Debug, Clone, Default)]
struct Proof {
    /// Times of the latest request and arrival, and revolutions between the latest arrivals.
    exchange: (f64, f64),
    turns: [f64; 2],
    /// Number of replies that did not follow a moved poll, less those that did.
    votes: i8,
    /// True if the next poll is moved.
    is_moved: bool,
    /// True if the latest reply is of a moved poll: the next one that is not moved is compared with it.
    is_compared: bool,
    /// Number of polls moved so far.
    moves: u8,
}

/// Sums of [`MotorClock`], and their determinant, which is the same from any point.
#[derive(Debug, Clone, Copy)]
struct Moments {
    sums: [f64; 3],
    determinant: f64,
}

impl MotorClock {
    /// Creates a clock of a motor whose revolution nominally takes this long.
    pub(crate) fn new(nominal: Duration) -> Self {
        let nominal = nominal.as_secs_f64();
        Self {
            origin: Instant::now(),
            nominal,
            period: nominal,
            known_period: None,
            latest: None,
            since: 0.0,
            sums: [0.0; 3],
            lateness: USUAL_LATENESS,
            fitting: 0,
            share: USUAL_SHARE,
            counted: f64::from(ENOUGH),
            doubt: DOUBT_AT_START,
            misfits: Misfits::default(),
            jumps: 0,
            proof: Proof::default(),
        }
    }

    /// Adds a reply whose first byte arrived at `arrived`. Its revolution ended before.
    pub(crate) fn observe(&mut self, requested: Instant, arrived: Instant) -> Revolution {
        let (requested, arrived) = (self.seconds(requested), self.seconds(arrived));
        self.proof.compare(requested, arrived, self.period);
        let mut revolution = self.place(requested, arrived);
        if self.proof.votes < PROVED && self.fitting >= ENOUGH {
            revolution.delay = duration(self.proof.delay(arrived - requested, self.period));
        }
        revolution
    }

    /// Finds the place of a reply on the line, or moves the line.
    #[inline]
    fn place(&mut self, requested: f64, arrived: f64) -> Revolution {
        let Some(latest) = self.latest else { return self.start(arrived) };
        let since = arrived - latest;
        // Rounds without a call of libm.
        let turns = ((since / self.period + 0.5) as i64) as f64;
        let lag = since - turns * self.period;
        let moments = self.moments(since, turns);
        let gate = self.gate(moments);
        match () {
            // Not a number if rounding has made the determinant negative.
            () if gate.is_nan() || gate >= self.period / 4.0 || since > LONGEST_GAP => {
                self.start(arrived)
            }
            () if lag.abs() <= gate => self.fit(moments, arrived, lag),
            () => self.misfit(requested, arrived, lag, gate),
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

    /// Adds a reply that arrived `lag` after the line.
    fn fit(&mut self, moments: Moments, arrived: f64, lag: f64) -> Revolution {
        self.misfits = Misfits::default();
        self.update_share(1.0);
        self.fitting += 1;
        self.doubt = self.doubt.saturating_sub(1);
        // While the period is unknown, an early arrival says nothing about the edge.
        let is_edge = lag < 0.0 && self.fitting > ENOUGH;
        let weight = if is_edge { EARLY_WEIGHT } else { 1.0 };
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
        let end = arrived - lag + wxx * gain;
        self.latest = Some(end);
        self.judge_period(determinant);
        self.on_line(end, arrived)
    }

    /// Judges a reply that does not fit: it is late unless the phase has changed.
    #[cold]
    fn misfit(&mut self, requested: f64, arrived: f64, lag: f64, gate: f64) -> Revolution {
        self.update_share(0.0);
        let late = if lag < 0.0 { lag + self.period } else { lag };
        let end = arrived - late;
        let is_early = lag < 0.0 && lag > -EARLY;
        if self.doubt > 0 {
            self.add_doubt(DOUBT_BY_MISFIT);
        }
        if is_early {
            self.doubt_move(lag);
        }
        if self.share < LEAST_SHARE {
            return self.start(arrived);
        }
        let is_rare = self.proof.turns[1] * self.period > RARE * (1.0 - self.share);
        let misfits = &mut self.misfits;
        misfits.in_a_row += 1;
        match misfits.votes {
            0 => (misfits.lag, misfits.votes) = (late, 1),
            _ if (late - misfits.lag).abs() <= gate => {
                misfits.lag = misfits.lag.min(late);
                misfits.votes += 1;
            }
            _ => misfits.votes -= 1,
        }
        let Misfits { in_a_row, lag: agreed, votes } = *misfits;
        let may_be_jump = votes > 1 || in_a_row > 2 || is_rare;
        match () {
            // No revolution since the request explains it.
            () if end < requested => self.jump(arrived, lag, 1.0),
            () if votes == JUMP => self.jump(end + agreed, agreed, f64::from(votes)),
            () if is_early || may_be_jump || end - requested >= self.period => self.at_arrival(),
            () => self.on_line(end, arrived),
        }
    }

    /// Moves the line by `lag`, to a revolution that ended at `end`.
    fn jump(&mut self, end: f64, lag: f64, weight: f64) -> Revolution {
        self.doubt_move(lag);
        // A second jump this soon means that the period is wrong, too.
        if self.fitting < ENOUGH {
            return self.start(end);
        }
        self.jumps += 1;
        self.set_phase(end, weight);
        self.at_arrival()
    }

    /// Starts the fit again with one arrival and the nominal period.
    fn start(&mut self, arrived: f64) -> Revolution {
        self.period = self.nominal;
        self.lateness = USUAL_LATENESS;
        (self.share, self.counted) = (USUAL_SHARE, f64::from(ENOUGH));
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
        self.since = end;
        self.fitting = 0;
        self.misfits = Misfits::default();
        self.known_period = None;
    }

    fn update_share(&mut self, fits: f64) {
        self.counted = (self.counted + 1.0).min(SHARE_REPLIES);
        self.share += (fits - self.share) / self.counted;
    }

    fn add_doubt(&mut self, more: u32) {
        self.doubt = (self.doubt + more).min(MOST_DOUBT);
    }

    /// Doubts the line after it moved by `lag`, or should.
    fn doubt_move(&mut self, lag: f64) {
        if lag.abs() > NEAR_LINE {
            self.add_doubt(if lag.abs() < EARLY { MOST_DOUBT } else { DOUBT });
        }
    }

    fn has_line(&self) -> bool {
        self.proof.votes == PROVED && self.fitting >= ENOUGH
    }

    /// Returns true if stamps rest on the line.
    fn is_known(&self) -> bool {
        self.has_line() && self.doubt == 0 && self.share >= STEADY
    }

    /// Decides whether the period is known, after a change of the line.
    fn judge_period(&mut self, determinant: f64) {
        let [w, ..] = self.sums;
        let sigmas = PERIOD_SIGMAS * self.lateness;
        let error = PERIOD_ERROR * self.period;
        let lasted = self.latest.map_or(0.0, |latest| latest - self.since);
        // Both sides squared, which saves the square root of the variance.
        let is_known = self.is_known()
            && lasted > LEAST_DURATION
            && sigmas * sigmas * w < error * error * determinant;
        self.known_period = is_known.then(|| duration(self.period));
    }

    fn on_line(&self, end: f64, arrived: f64) -> Revolution {
        if !self.is_known() {
            return Revolution::default();
        }
        Revolution { lateness: Some(duration(arrived - end)), ..self.at_arrival() }
    }

    fn at_arrival(&self) -> Revolution {
        Revolution {
            period: self.known_period.filter(|_| self.is_known()),
            ..Revolution::default()
        }
    }
}

impl Proof {
    /// How much later to send the next poll, which would wait as long for its reply as the latest one
    /// `waited`.
    fn delay(&mut self, waited: f64, period: f64) -> f64 {
        let turns = MOVED_TURNS.get(usize::from(self.moves) % MOVED_TURNS.len());
        let delay = match turns.filter(|_| self.skips_revolutions()) {
            Some(turns) => turns * period,
            None => MOVED_PART * waited.min(period),
        };
        if self.votes.abs() >= PROVED
            || self.is_compared
            || self.moves == MOST_MOVES
            || delay < 1.1 * LEAST_MOVE
        {
            return 0.0;
        }
        self.moves += 1;
        self.is_moved = true;
        delay
    }

    /// Compares how far request and reply moved within the revolution since the ones before. A
    /// sensor that answers at once moves both by the same time.
    fn compare(&mut self, requested: f64, arrived: f64, period: f64) {
        let (before, answered) = std::mem::replace(&mut self.exchange, (requested, arrived));
        self.turns = [self.turns[1], (arrived - answered) / period];
        // Polls on a grid may show each second or third revolution: only other ones tell.
        self.is_compared = std::mem::take(&mut self.is_moved);
        let is_told = self.is_compared || !self.skips_revolutions();
        if self.votes == PROVED || !is_told {
            return;
        }
        let moved = part((requested - before) / period);
        if moved.abs() * period <= LEAST_MOVE {
            return;
        }
        let followed = part((arrived - answered) / period);
        let is_near = |part: f64| part.abs() * period < FOLLOWS;
        let vote = match () {
            () if is_near(followed) => 1,
            () if is_near(part(followed - moved)) => -2,
            () if self.skips_revolutions() => -2,
            () => 0,
        };
        self.votes = (self.votes + vote).clamp(-PROVED, PROVED);
    }

    /// Returns true if some recent replies were more than a revolution apart.
    fn skips_revolutions(&self) -> bool {
        let [before, latest] = self.turns;
        before + latest > 3.0
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
