//! [`Window`]: the steps to ask for: all, those in an interval of degrees, or steps by number.

use std::fmt;
use std::hash::{Hash, Hasher};
use std::ops::RangeInclusive;

use super::Geometry;

/// Last step of a `G` (C-42-3320-A p. 6).
pub(super) const LAST: u16 = 768;
/// Last step that a request of SCIP 2 can name, with four digits (C-42-03320B p. 11).
const LAST_OF_ANY: u16 = 9999;
/// Micro-degrees to either side of the front that a window of degrees may include.
const FARTHEST: i32 = 135_000_000;

/// Length of a `G` and of its echo in bytes, LF included (p. 6).
const POLL_LEN: usize = 10;
/// Data bytes in a full line of a `G` reply (p. 3 and 6).
pub(super) const BLOCK: usize = 64;

/// Directions that a scan covers: all that the sensor measures ([`Window::DETECTION`]), an interval of
/// [degrees](Window::degrees), or [steps](Window::new) by their number. A cluster count groups them.
///
/// A step is a direction of measurement. Steps count counter-clockwise, seen from above:
/// [`Geometry::degrees`] is their direction. For a URG-04LX, 0 is -135 degrees (right rear), 384 the
/// front, 768 is +135 degrees (left rear). Another model has other steps, and step 384 may be
/// another direction: write degrees to get the same directions from each.
///
/// The window of a [`Scan`](crate::Scan) has the steps of its sensor. A window that you create has
/// the steps of a URG-04LX, whatever sensor you will pass it to.
///
/// A window that you create has steps in 0..=9999, its start is not after its end, and its cluster
/// count is 1..=99. (The protocol text allows a cluster count of 0, but sensors may disagree on what
/// it means.) A sensor that does not have these steps refuses the window with
/// [`WindowError::NotMeasured`]: a URG-04LX has 0..=768, a UST-10LX 0..=1080.
///
/// `==` compares steps and cluster counts, however you asked for them.
///
/// As data (feature `serde`) it is `start`, `end` and `cluster`. You may leave out a `cluster` of 1.
///
/// ```
/// use tokio_scip::Window;
///
/// let window = Window::new(44..=725)?.with_cluster_count(4)?;
/// assert_eq!(window.points(), 171); // 682 steps in groups of 4, the last one partial
/// # Ok::<(), tokio_scip::protocol::WindowError>(())
/// ```
#[derive(Debug, Clone, Copy)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "UncheckedWindow"))]
pub struct Window {
    start: u16,
    end: u16,
    #[cfg_attr(feature = "serde", serde(rename = "cluster"))]
    cluster_count: u8,
    #[cfg_attr(feature = "serde", serde(skip))]
    wish: Wish,
}

/// What a window was asked to cover, on any sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wish {
    /// Everything that the sensor measures.
    All,
    /// Everything that the sensor answers for.
    Answered,
    /// The steps inside an interval of micro-degrees, counter-clockwise from the front. The least and
    /// the largest number stand for the ends of what the sensor measures.
    Degrees(i32, i32),
    /// The steps of the window.
    Steps,
}

/// Unvalidated window, as data.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct UncheckedWindow {
    start: u16,
    end: u16,
    #[serde(default = "one")]
    cluster: u8,
}

#[cfg(feature = "serde")]
fn one() -> u8 {
    1
}

#[cfg(feature = "serde")]
impl TryFrom<UncheckedWindow> for Window {
    type Error = WindowError;

    fn try_from(fields: UncheckedWindow) -> Result<Self, WindowError> {
        Self::new(fields.start..=fields.end)?.with_cluster_count(fields.cluster)
    }
}

impl Window {
    /// Every step that the sensor sends. For a URG-04LX in SCIP 1.1: steps 0..=768, and those outside
    /// of [`Window::DETECTION`] carry error code 19. Others send only what they measure.
    ///
    /// In SCIP 1.1 this window and some clustered ones leave no spare step. Their polls cannot differ:
    /// one safeguard less against a reply that a faulty line delivers twice.
    pub const FULL: Self = Self { wish: Wish::Answered, ..Self::from_steps(0, LAST) };

    /// All that the sensor measures. For a URG-04LX: steps 44..=725, -119.53 to +119.88 degrees.
    pub const DETECTION: Self = Self { wish: Wish::All, ..Self::from_steps(44, 725) };

    const fn from_steps(start: u16, end: u16) -> Self {
        Self { start, end, cluster_count: 1, wish: Wish::Steps }
    }

    /// Creates a window of `steps`, each a point of its own (cluster count 1).
    ///
    /// # Errors
    ///
    /// [`WindowError`] if a step is above 9999 or the start after the end.
    pub const fn new(steps: RangeInclusive<u16>) -> Result<Self, WindowError> {
        let (start, end) = (*steps.start(), *steps.end());
        match (start, end) {
            (found, _) | (_, found) if found > LAST_OF_ANY => Err(WindowError::Step { found }),
            _ if start > end => Err(WindowError::Reversed { start, end }),
            _ => Ok(Self::from_steps(start, end)),
        }
    }

    /// Creates the window of the steps inside an interval of degrees, counter-clockwise
    /// from the front: `Window::degrees(-90.0..=90.0)` is steps 128..=640 of a URG-04LX. Another
    /// sensor gets the interval itself, and sends the steps that it has inside.
    ///
    /// Bounds are rounded to a millionth of a degree. An infinite bound stands for the last direction
    /// that the sensor measures: `Window::degrees(0.0..=f64::INFINITY)` is all to the left of the front.
    ///
    /// # Errors
    ///
    /// [`WindowError`] if the interval has no infinite bound and contains no step of a URG-04LX, if a
    /// finite bound is outside of -135..=135, or if a bound is not a number.
    pub fn degrees(interval: RangeInclusive<f64>) -> Result<Self, WindowError> {
        let (from, to) = interval.into_inner();
        let error = WindowError::Degrees { from, to };
        if from.is_nan() || to.is_nan() {
            return Err(error);
        }
        // The casts go no further than the ends of the type, which stand for infinite bounds.
        let [low, high] = [from, to].map(|degrees| (degrees * 1e6).round() as i32);
        let window = Self { wish: Wish::Degrees(low, high), ..Self::DETECTION };
        if from.is_finite() && low < -FARTHEST || to.is_finite() && high > FARTHEST {
            return Err(error);
        }
        let is_open =
            from == f64::NEG_INFINITY && to >= -135.0 || to == f64::INFINITY && from <= 135.0;
        window.resolve(&Geometry::URG_04LX).or(if is_open { Ok(window) } else { Err(error) })
    }

    /// Returns this window with the steps of a sensor.
    ///
    /// # Errors
    ///
    /// [`WindowError::NotMeasured`] if the sensor does not measure all of it.
    #[inline(never)]
    pub fn resolve(self, geometry: &Geometry) -> Result<Self, WindowError> {
        let answered = geometry.answered_steps();
        let (start, end) = match self.wish {
            Wish::All => (geometry.first_step.into(), geometry.last_step.into()),
            Wish::Answered => ((*answered.start()).into(), (*answered.end()).into()),
            Wish::Degrees(from, to) => measured_inside(geometry, from, to),
            Wish::Steps => (self.start.into(), self.end.into()),
        };
        match (u16::try_from(start), u16::try_from(end)) {
            (Ok(start), Ok(end))
                if start >= *answered.start() && end <= *answered.end() && start <= end =>
            {
                Ok(Self { start, end, ..self })
            }
            _ => Err(WindowError::NotMeasured { window: self, geometry: *geometry }),
        }
    }

    /// Returns true if `other` asks for the same on every sensor: all that it measures or sends, the
    /// same degrees or the same steps, in the same clusters. Finds the [statistics](crate::stats::ScheduleStats) of a
    /// stream, whose window has the steps of the sensor.
    ///
    /// Equal windows may differ in this: one of all that the sensor measures, one of steps 44..=725.
    pub fn is_same_wish(&self, other: &Self) -> bool {
        self.wish == other.wish
            && self.cluster_count == other.cluster_count
            && (self.wish != Wish::Steps || self == other)
    }

    /// Returns true if a scan of this window shows all of `other`, as a stream that serves both does.
    #[doc(hidden)]
    pub fn holds(&self, other: &Self) -> bool {
        let is_inside = self.start <= other.start && other.end <= self.end;
        self == other || self.cluster_count == 1 && is_inside
    }

    /// Smallest window that holds both.
    pub(crate) fn hull(&self, other: &Self) -> Self {
        if self == other {
            return *self;
        }
        Self::from_steps(self.start.min(other.start), self.end.max(other.end))
    }

    /// Groups the same steps into clusters of `cluster_count` neighbours. The sensor sends one value for
    /// each, which saves time on the line but loses points: in SCIP 2 the smallest distance, in SCIP 1.1
    /// the smallest value, so that one error code (0..=19) hides every distance of its cluster.
    ///
    /// # Errors
    ///
    /// [`WindowError::ClusterCount`] outside of 1..=99.
    pub const fn with_cluster_count(self, cluster_count: u8) -> Result<Self, WindowError> {
        match cluster_count {
            1..=99 => Ok(Self { cluster_count, ..self }),
            found => Err(WindowError::ClusterCount { found }),
        }
    }

    /// First step.
    pub const fn start(&self) -> u16 {
        self.start
    }

    /// Last step.
    pub const fn end(&self) -> u16 {
        self.end
    }

    /// Number of neighbouring steps that make a point, 1..=99.
    pub const fn cluster_count(&self) -> u8 {
        self.cluster_count
    }

    /// Number of steps in the window, at most 769 for a URG-04LX.
    pub const fn steps(&self) -> usize {
        (self.end - self.start) as usize + 1
    }

    /// Number of points in a scan of this window: steps over cluster count, rounded up.
    // Several times a scan, and a division each: one copy of its code.
    #[inline(never)]
    pub const fn points(&self) -> usize {
        self.steps().div_ceil(self.cluster_count as usize)
    }

    /// Length of the reply in bytes, terminator included: 1,576 for [`Window::FULL`].
    pub(crate) const fn reply_len(&self) -> usize {
        let data = self.points() * 2;
        // Echo and status, each with its LF; data with an LF per block; one more LF.
        POLL_LEN + 2 + data + data.div_ceil(BLOCK) + 1
    }

    /// Number of bytes of a `G` and its reply, terminators included.
    pub(crate) const fn exchange_len(&self) -> usize {
        POLL_LEN + self.reply_len()
    }

    /// Start, end and cluster count as one number, which is never 0. It is cheaper to compare.
    pub(crate) const fn key(&self) -> u64 {
        self.start as u64 | (self.end as u64) << 16 | (self.cluster_count as u64) << 32
    }

    /// Number of steps in the first cluster.
    pub(crate) fn first_cluster(&self) -> u8 {
        // At most the cluster count, so the cast is exact.
        self.steps().min(usize::from(self.cluster_count)) as u8
    }

    /// The driver adds at most this many points to a poll, so that it differs from the previous ones.
    pub(crate) const MAX_EXTRA_POINTS: u16 = 3;

    /// Returns true if the driver may poll `asked` to get the scans of this window: the same
    /// steps, or up to three more points in front or at the end, which make the echoes of
    /// successive polls differ. Finds the replies of a stream among all replies, as
    /// [`on_reply`](crate::SensorBuilder::on_reply) observes them.
    #[doc(hidden)]
    pub fn is_polled_as(&self, asked: Window) -> bool {
        let mut widened = (0..=Self::MAX_EXTRA_POINTS).filter_map(|points| self.widened(points));
        widened.any(|(window, _)| window == asked)
    }

    /// Adds `points` points in front or, without room there, at the end. Also returns the number
    /// of points to skip in front. Returns `None` if neither side has room. The points of this
    /// window are the same in the wider one.
    pub(crate) fn widened(&self, points: u16) -> Option<(Self, usize)> {
        let steps = points.saturating_mul(u16::from(self.cluster_count));
        match self.start.checked_sub(steps) {
            Some(start) => Some((Self { start, ..*self }, usize::from(points))),
            // Steps after the end would fill up a partial last cluster.
            None if !self.steps().is_multiple_of(self.cluster_count.into()) => None,
            None => {
                let end = self.end.saturating_add(steps);
                (end <= LAST).then_some((Self { end, ..*self }, 0))
            }
        }
    }

    /// Creates the window of one step.
    pub(crate) const fn single(step: u16) -> Self {
        let step = if step > LAST { LAST } else { step };
        Self::from_steps(step, step)
    }
}

impl PartialEq for Window {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Window {}

impl Hash for Window {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.key().hash(state);
    }
}

impl fmt::Display for Window {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "steps {}..={}", self.start, self.end)?;
        if self.cluster_count > 1 {
            write!(f, " in clusters of {}", self.cluster_count)?;
        }
        Ok(())
    }
}

/// Error for parameters that make no [`Window`].
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// A step is above 9999.
    #[error("invalid step {found}: expected 0 to 9999")]
    Step {
        /// Number that was found.
        found: u16,
    },
    /// Its start is after its end.
    #[error(
        "invalid window: expected its start before its end, found {start} and {end}: swap them"
    )]
    Reversed {
        /// First step.
        start: u16,
        /// Last step.
        end: u16,
    },
    /// Its cluster count is outside 1..=99.
    #[error("invalid cluster count {found}: expected 1 to 99")]
    ClusterCount {
        /// Number that was found.
        found: u8,
    },
    /// An interval of degrees has a finite bound outside of -135..=135, or contains no step.
    #[error(
        "invalid window from {from} to {to} degrees: expected -135 to 135, the smaller one first, with at least one step (0.3515625 degree) inside"
    )]
    Degrees {
        /// Lower bound.
        from: f64,
        /// Upper bound.
        to: f64,
    },
    /// The sensor does not measure all of it.
    #[error("{}: this sensor {}", wanted(window), measured(geometry))]
    NotMeasured {
        /// Window that was asked for.
        window: Window,
        /// What the sensor measures.
        geometry: Geometry,
    },
}

/// First and last step inside an interval of a [`Wish::Degrees`].
// Not in `resolve`, which runs for each scan.
#[inline(never)]
fn measured_inside(geometry: &Geometry, from: i32, to: i32) -> (i64, i64) {
    let (first, last) = geometry.steps().into_inner();
    let (start, end) = geometry.steps_inside((from, to));
    let start = if from == i32::MIN { first.into() } else { start };
    (start, if to == i32::MAX { last.into() } else { end })
}

/// Writes what a window was asked to cover.
fn wanted(window: &Window) -> String {
    match window.wish {
        Wish::Degrees(from, to) => {
            let [from, to] = [from, to].map(|bound| match bound {
                i32::MIN => f64::NEG_INFINITY,
                i32::MAX => f64::INFINITY,
                bound => f64::from(bound) / 1e6,
            });
            format!("invalid window from {from} to {to} degrees")
        }
        Wish::All | Wish::Answered | Wish::Steps => {
            format!("invalid window of steps {}..={}", window.start, window.end)
        }
    }
}

/// Writes which steps a sensor measures.
fn measured(geometry: &Geometry) -> String {
    let (first, last) = geometry.steps().into_inner();
    let [from, to] = [first, last].map(|step| geometry.degrees(step));
    let apart = geometry.step_angle().to_degrees();
    format!(
        "measures steps {first}..={last} ({from:.2} to {to:.2} degrees), {apart:.3} degrees apart"
    )
}
