//! [`Line`]: fits a line to times that arrive late, and [`Misfits`]: those that it does not fit.

/// Weight of an arrival below the line. An arrival above it has weight 1.
pub(super) const EARLY_WEIGHT: f64 = 40.0;
/// Standard deviation in seconds of arrivals that USB delays by up to a frame, and of whole milliseconds.
const DEVIATION: f64 = 0.3e-3;

/// Line by least squares, which forgets. Its sums count from its latest point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// Value at the latest point, and change of the value in one unit.
    pub(super) value: f64,
    pub(super) slope: f64,
    /// Sums of `w`, `w x` and `w x²` over all points with their weights `w`.
    sums: [f64; 3],
}

impl Line {
    /// Line through one point, whose slope is known to within this deviation.
    pub(super) fn new(value: f64, slope: f64, slope_deviation: f64) -> Self {
        let deviation = slope_deviation / DEVIATION;
        Self { value, slope, sums: [1.0, 0.0, 1.0 / (deviation * deviation)] }
    }

    /// Moves on by `ahead` units, with this part of the sums forgotten.
    pub(super) fn advance(&mut self, ahead: f64, forgotten: f64) {
        let kept = 1.0 / (1.0 + forgotten.max(0.0));
        let [w, wx, wxx] = self.sums.map(|sum| sum * kept);
        let moved = wx - ahead * w;
        self.value += self.slope * ahead;
        self.sums = [w, moved, wxx - ahead * (wx + moved)];
    }

    /// Standard deviation of the value. Not a number if rounding has made the determinant negative.
    pub(super) fn deviation(&self) -> f64 {
        let [w, wx, wxx] = self.sums;
        DEVIATION * (wxx / (w * wxx - wx * wx)).sqrt()
    }

    /// Adds a point that is this far above the line.
    pub(super) fn add(&mut self, above: f64, weight: f64) {
        let [w, wx, wxx] = self.sums;
        self.sums = [w + weight, wx, wxx];
        let gain = weight * above / ((w + weight) * wxx - wx * wx);
        self.slope -= wx * gain;
        self.value += wxx * gain;
    }

    /// Moves to another value, which this many points agree on. Keeps what is known of the slope.
    pub(super) fn jump(&mut self, value: f64, points: u32) {
        let [w, wx, wxx] = self.sums;
        self.value = value;
        self.sums = [points.into(), 0.0, wxx - wx * wx / w];
    }
}

/// How late most recent misfits are, and their votes (the majority vote of Boyer and Moore).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Misfits {
    pub(super) late: f64,
    pub(super) votes: u32,
}

impl Misfits {
    /// Counts one that is this late. It agrees with others to within `gate`.
    pub(super) fn count(&mut self, late: f64, gate: f64) {
        let Self { late: agreed, votes } = *self;
        (self.late, self.votes) = match votes {
            0 => (late, 1),
            _ if (late - agreed).abs() > gate => (agreed, votes - 1),
            _ => (agreed + (late - agreed) / f64::from(votes + 1), votes + 1),
        };
    }
}
