//! [`Picture`]: a rectangle of the wall, from 0,0 at the top left to 1,1 at the bottom right.

use super::Result;

/// Two coordinates: metres in the sensor's frame, or a place in the picture.
pub(crate) type Spot = (f64, f64);

pub(super) fn distance(a: Spot, b: Spot) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

fn cross(a: Spot, b: Spot) -> f64 {
    a.0 * b.1 - a.1 * b.0
}

/// A homography: u,v of the picture is at x = (a u + b v + c) / (g u + h v + 1), and at y with
/// d, e and f in place of a, b and c.
pub(crate) struct Picture {
    x: [f64; 3],
    y: [f64; 3],
    scale: [f64; 2],
}

impl Picture {
    /// Takes the corners in order: top left, top right, bottom right, bottom left.
    pub(crate) fn new(corners: [Spot; 4]) -> Result<Self> {
        let [p, q, r, s] = corners;
        let area =
            |a: Spot, b: Spot, c: Spot| cross((b.0 - a.0, b.1 - a.1), (c.0 - b.0, c.1 - b.1));
        let areas = [area(p, q, r), area(q, r, s), area(r, s, p), area(s, p, q)];
        // They turn left if the sensor lies with its top towards the wall.
        if !areas.iter().all(|&area| area < -0.001) && !areas.iter().all(|&area| area > 0.001) {
            let order = "top left, top right, bottom right, bottom left";
            return Err(format!("{corners:?}: expected four corners, in the order {order}").into());
        }
        let right = (q.0 - r.0, q.1 - r.1);
        let left = (s.0 - r.0, s.1 - r.1);
        let skew = (p.0 - q.0 + r.0 - s.0, p.1 - q.1 + r.1 - s.1);
        let g = cross(skew, left) / cross(right, left);
        let h = cross(right, skew) / cross(right, left);
        let x = [q.0 - p.0 + g * q.0, s.0 - p.0 + h * s.0, p.0];
        let y = [q.1 - p.1 + g * q.1, s.1 - p.1 + h * s.1, p.1];
        Ok(Self { x, y, scale: [g, h] })
    }

    /// Returns the place in the picture, or `None` if it lies outside.
    pub(crate) fn place(&self, (x, y): Spot) -> Option<Spot> {
        let Self { x: [a, b, c], y: [d, e, f], scale: [g, h] } = self;
        // Two linear equations in u and v.
        let by_u = (a - g * x, d - g * y);
        let by_v = (b - h * x, e - h * y);
        let known = (x - c, y - f);
        let u = cross(known, by_v) / cross(by_u, by_v);
        let v = cross(by_u, known) / cross(by_u, by_v);
        let is_inside = |coordinate| (0.0..=1.0).contains(&coordinate);
        (is_inside(u) && is_inside(v)).then_some((u, v))
    }
}
