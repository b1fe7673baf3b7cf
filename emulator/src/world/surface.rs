//! Surfaces that reflect the sensor's beam, and where a beam meets them.
//!
//! Plane geometry in millimetres, x forward and y left of the sensor. It uses only
//! additions, multiplications, divisions and square roots. IEEE 754 defines these to the
//! last bit, so the scans are the same on every machine.

/// Position, or direction of length 1.
pub(super) type Vector = (f64, f64);

/// Converts a position in metres.
pub(super) fn millimetres((x, y): (f64, f64)) -> Vector {
    (x * 1000.0, y * 1000.0)
}

/// Nearest surface that a beam meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Echo {
    /// Distance in millimetres.
    pub(super) distance: f64,
    /// Fraction of the light that is reflected to the sensor.
    pub(super) light: f64,
}

impl Echo {
    /// No surface, as through a window: farther than any sensor measures.
    pub(super) const NONE: Self = Self { distance: 1e6, light: 1.0 };
}

/// Object with a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    shape: Shape,
    /// Fraction of the light that it reflects.
    reflects: f64,
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    Disc { centre: Vector, radius: f64 },
    Block { low: Vector, high: Vector },
    Wall { from: Vector, to: Vector },
}

impl Surface {
    pub(super) fn disc(centre: Vector, radius: f64, reflects: f64) -> Self {
        Self { shape: Shape::Disc { centre, radius }, reflects }
    }

    pub(super) fn block(low: Vector, high: Vector, reflects: f64) -> Self {
        Self { shape: Shape::Block { low, high }, reflects }
    }

    pub(super) fn wall(from: Vector, to: Vector, reflects: f64) -> Self {
        Self { shape: Shape::Wall { from, to }, reflects }
    }

    /// Returns the surface as seen from another place: moved by `-at`.
    pub(super) fn seen_from(mut self, at: Vector) -> Self {
        let moved = |(x, y): Vector| (x - at.0, y - at.1);
        self.shape = match self.shape {
            Shape::Disc { centre, radius } => Shape::Disc { centre: moved(centre), radius },
            Shape::Block { low, high } => Shape::Block { low: moved(low), high: moved(high) },
            Shape::Wall { from, to } => Shape::Wall { from: moved(from), to: moved(to) },
        };
        self
    }

    /// Echo of a beam from the sensor in this direction, if it meets the surface. A flat
    /// angle reflects less light.
    pub(super) fn echo(&self, direction: Vector) -> Option<Echo> {
        let (distance, cosine) = match self.shape {
            Shape::Disc { centre, radius } => disc(direction, centre, radius)?,
            Shape::Block { low, high } => block(direction, low, high)?,
            Shape::Wall { from, to } => wall(direction, from, to)?,
        };
        (distance > 0.0).then_some(Echo { distance, light: self.reflects * cosine })
    }
}

fn disc((x, y): Vector, centre: Vector, radius: f64) -> Option<(f64, f64)> {
    let nearest = centre.0 * x + centre.1 * y;
    let away = centre.0 * y - centre.1 * x;
    let inside = radius * radius - away * away;
    (inside >= 0.0).then(|| (nearest - inside.sqrt(), inside.sqrt() / radius))
}

fn block((x, y): Vector, low: Vector, high: Vector) -> Option<(f64, f64)> {
    let sorted = |a: f64, b: f64| (a.min(b), a.max(b));
    let (x_in, x_out) = sorted(low.0 / x, high.0 / x);
    let (y_in, y_out) = sorted(low.1 / y, high.1 / y);
    let is_met = x_in.max(y_in) <= x_out.min(y_out);
    is_met.then(|| (x_in.max(y_in), if x_in > y_in { x.abs() } else { y.abs() }))
}

fn wall(direction: Vector, from: Vector, to: Vector) -> Option<(f64, f64)> {
    let cross = |a: Vector, b: Vector| a.0 * b.1 - a.1 * b.0;
    let along = (to.0 - from.0, to.1 - from.1);
    // Solves distance * direction = from + share * along.
    let flatness = cross(direction, along);
    let share = cross(from, direction) / flatness;
    let length = (along.0 * along.0 + along.1 * along.1).sqrt();
    // NaN for a beam along the wall, or a wall without length: no echo.
    (0.0..=1.0).contains(&share).then(|| (cross(from, along) / flatness, flatness.abs() / length))
}

/// Nearest echo of `surfaces`, or `background` if that is nearer.
pub(super) fn nearest(
    surfaces: impl IntoIterator<Item = Surface>,
    direction: Vector,
    background: Echo,
) -> Echo {
    surfaces.into_iter().filter_map(|surface| surface.echo(direction)).fold(
        background,
        |nearest, echo| if echo.distance < nearest.distance { echo } else { nearest },
    )
}
