//! [`Polygon`]: which points and directions a simple polygon contains.

use super::ZoneError;

/// Largest coordinate of a vertex in metres. Products of larger numbers could overflow.
const FARTHEST: f64 = 1000.0;
/// Most vertices; comparing all pairs of edges takes milliseconds then.
const MAX_VERTICES: usize = 1000;

/// Point or vector in metres, x and y.
type Coordinates = (f64, f64);

/// Polygon whose edges do not touch each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Polygon(Box<[Coordinates]>);

impl Polygon {
    pub(super) fn new(vertices: impl IntoIterator<Item = Coordinates>) -> Result<Self, ZoneError> {
        let mut kept: Vec<Coordinates> = Vec::new();
        for (index, (x, y)) in vertices.into_iter().enumerate() {
            // No range contains NaN.
            if ![x, y].iter().all(|number| (-FARTHEST..=FARTHEST).contains(number)) {
                return Err(ZoneError::Vertex { index, x, y });
            }
            if index >= MAX_VERTICES {
                return Err(ZoneError::Vertices { found: index + 1 });
            }
            kept.push((x, y));
        }
        kept.dedup();
        // Many formats repeat the first vertex at the end.
        if kept.len() > 1 && kept.first() == kept.last() {
            kept.pop();
        }
        if kept.len() < 3 {
            return Err(ZoneError::Vertices { found: kept.len() });
        }
        let polygon = Self(kept.into());
        match polygon.crossing() {
            Some((x, y)) => Err(ZoneError::Crossing { x, y }),
            None => Ok(polygon),
        }
    }

    /// Returns true if the point is inside, or at most `tolerance` metres from an edge.
    pub(super) fn contains(&self, point: Coordinates, tolerance: f64) -> bool {
        let mut winding = 0;
        for (a, b) in self.edges() {
            if squared_distance(point, a, b) <= tolerance * tolerance {
                return true;
            }
            // Edges that cross the line through the point, to the point's right.
            let side = cross(minus(b, a), minus(point, a));
            if a.1 <= point.1 && b.1 > point.1 && side > 0.0 {
                winding += 1;
            } else if a.1 > point.1 && b.1 <= point.1 && side < 0.0 {
                winding -= 1;
            }
        }
        winding != 0
    }

    /// Returns the distance from the origin to the farthest edge in the direction of `angle`
    /// radians, or `None` if no edge lies there.
    pub(super) fn far(&self, angle: f64) -> Option<f64> {
        let (sin, cos) = angle.sin_cos();
        let ray = (cos, sin);
        let hits = self.edges().filter_map(|(a, b)| {
            let (beside_a, beside_b) = (cross(ray, a), cross(ray, b));
            let (along_a, along_b) = (dot(ray, a), dot(ray, b));
            if beside_a * beside_b > 0.0 {
                None
            } else if beside_a == beside_b {
                Some(along_a.max(along_b))
            } else {
                Some(along_a + (along_b - along_a) * beside_a / (beside_a - beside_b))
            }
        });
        hits.filter(|far| *far >= 0.0).reduce(f64::max)
    }

    /// Returns the distance from the origin to the farthest vertex.
    pub(super) fn reach(&self) -> f64 {
        self.0.iter().map(|vertex| vertex.0.hypot(vertex.1)).fold(0.0, f64::max)
    }

    fn edges(&self) -> impl Iterator<Item = (Coordinates, Coordinates)> + Clone + '_ {
        let ends = self.0.iter().skip(1).chain(self.0.first());
        self.0.iter().copied().zip(ends.copied())
    }

    /// Returns the start of an edge that touches another one elsewhere than at their common
    /// vertex.
    fn crossing(&self) -> Option<Coordinates> {
        let last = self.0.len() - 1;
        for (n, (a, b)) in self.edges().enumerate() {
            for (m, (c, d)) in self.edges().enumerate().skip(n + 1) {
                let touch = match () {
                    () if m == n + 1 => turns_back(a, b, d),
                    () if n == 0 && m == last => turns_back(c, d, b),
                    () => touch((a, b), (c, d)),
                };
                if touch {
                    return Some(c);
                }
            }
        }
        None
    }
}

fn minus(a: Coordinates, b: Coordinates) -> Coordinates {
    (a.0 - b.0, a.1 - b.1)
}

fn dot(a: Coordinates, b: Coordinates) -> f64 {
    a.0 * b.0 + a.1 * b.1
}

/// Positive if `b` points to the left of `a`.
fn cross(a: Coordinates, b: Coordinates) -> f64 {
    a.0 * b.1 - a.1 * b.0
}

/// Returns true if the way from `a` over `b` to `c` turns back onto itself.
fn turns_back(a: Coordinates, b: Coordinates, c: Coordinates) -> bool {
    let (first, second) = (minus(b, a), minus(c, b));
    cross(first, second) == 0.0 && dot(first, second) < 0.0
}

/// Returns true if two edges have a point in common.
fn touch((a, b): (Coordinates, Coordinates), (c, d): (Coordinates, Coordinates)) -> bool {
    let on_both_sides = |from, to, p, q| {
        let edge = minus(to, from);
        cross(edge, minus(p, from)) * cross(edge, minus(q, from)) <= 0.0
    };
    let overlap = |a: f64, b: f64, c: f64, d: f64| a.min(b) <= c.max(d) && c.min(d) <= a.max(b);
    // The rectangles around them matter where all four points lie on one line.
    overlap(a.0, b.0, c.0, d.0)
        && overlap(a.1, b.1, c.1, d.1)
        && on_both_sides(a, b, c, d)
        && on_both_sides(c, d, a, b)
}

/// Returns the squared distance from a point to the edge from `a` to `b`.
fn squared_distance(point: Coordinates, a: Coordinates, b: Coordinates) -> f64 {
    let (edge, to_point) = (minus(b, a), minus(point, a));
    let along = (dot(to_point, edge) / dot(edge, edge)).clamp(0.0, 1.0);
    let rest = minus(to_point, (edge.0 * along, edge.1 * along));
    dot(rest, rest)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;

    use super::*;

    const SQUARE: [Coordinates; 4] = [(1.0, -1.0), (3.0, -1.0), (3.0, 1.0), (1.0, 1.0)];

    /// Returns a polygon with a vertex at these distances from `middle`, at equal angles.
    fn star(middle: Coordinates, distances: &[f64]) -> Vec<Coordinates> {
        let angle = TAU / distances.len() as f64;
        let vertex = |(n, distance): (usize, &f64)| {
            let (sin, cos) = (n as f64 * angle).sin_cos();
            (middle.0 + distance * cos, middle.1 + distance * sin)
        };
        distances.iter().enumerate().map(vertex).collect()
    }

    proptest! {
        #[test]
        fn nothing_of_a_polygon_is_beyond_its_far_end(
            distances in prop::collection::vec(0.1..3.0, 3..12),
            middle in (-2.0..2.0, -2.0..2.0),
            angle in -4.0..4.0,
        ) {
            let polygon = Polygon::new(star(middle, &distances)).unwrap();
            let (sin, cos) = f64::sin_cos(angle);
            let inside = |range: f64| polygon.contains((range * cos, range * sin), 1e-9);
            let last = (0..600).rev().map(|n| f64::from(n) * 0.01).find(|range| inside(*range));
            match (polygon.far(angle), last) {
                (Some(far), last) => {
                    prop_assert!(inside(far), "{}", far);
                    prop_assert!(last.is_none_or(|last| last <= far + 1e-9 && far <= polygon.reach() + 1e-9));
                }
                (None, last) => prop_assert_eq!(last, None),
            }
        }
    }

    #[test]
    fn edges_and_vertices_belong_to_the_polygon() {
        let square = Polygon::new(SQUARE).unwrap();
        for point in [(1.0, -1.0), (3.0, 1.0), (2.0, 1.0), (1.0, 0.3), (2.0, 0.0)] {
            assert!(square.contains(point, 1e-6), "{point:?}");
        }
        for point in [(0.999, 0.0), (2.0, 1.001), (4.0, 1.0), (f64::NAN, 0.0), (2.0, f64::NAN)] {
            assert!(!square.contains(point, 1e-6), "{point:?}");
        }
        assert!(square.contains((2.0, 1.000_000_5), 1e-6));
    }

    #[test]
    fn vertices_that_make_no_outline_are_refused() {
        let refused = |vertices: &[Coordinates]| Polygon::new(vertices.to_vec()).unwrap_err();
        let few = |found| ZoneError::Vertices { found };
        assert_eq!(refused(&[]), few(0));
        assert_eq!(refused(&[(1.0, 1.0)]), few(1));
        assert_eq!(refused(&[(1.0, 1.0), (2.0, 1.0)]), few(2));
        assert_eq!(refused(&[(1.0, 1.0), (1.0, 1.0), (2.0, 1.0), (1.0, 1.0)]), few(2));
        let (vertices, most) = (star((0.0, 0.0), &[1.0; 1001]), star((0.0, 0.0), &[1.0; 1000]));
        assert_eq!(refused(&vertices), few(1001));
        assert!(Polygon::new(most).is_ok());
        for x in [f64::NAN, f64::INFINITY, 1000.1, -1e300] {
            let error = refused(&[(0.0, 0.0), (1.0, 0.0), (x, 1.0)]);
            assert!(matches!(error, ZoneError::Vertex { index: 2, y: 1.0, .. }), "{error}");
            let error = refused(&[(0.0, x), (1.0, 0.0), (0.0, 1.0)]);
            assert!(matches!(error, ZoneError::Vertex { index: 0, x: 0.0, .. }), "{error}");
        }
        for crossing in [
            // A bow tie, a spike, three vertices on a line, and an outline that touches itself.
            vec![(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)],
            vec![(0.0, 0.0), (2.0, 0.0), (1.0, 0.0), (1.0, 1.0)],
            vec![(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)],
            vec![(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 0.0), (0.0, 2.0)],
        ] {
            let error = refused(&crossing);
            assert!(matches!(error, ZoneError::Crossing { .. }), "{crossing:?}: {error}");
        }
    }

    #[test]
    fn repeated_and_collinear_vertices_change_nothing() {
        let closed = SQUARE.into_iter().chain([SQUARE[0]]);
        assert_eq!(Polygon::new(closed), Polygon::new(SQUARE));
        let doubled = SQUARE.into_iter().flat_map(|vertex| [vertex, vertex]);
        assert_eq!(Polygon::new(doubled), Polygon::new(SQUARE));
        let straight = [(1.0, -1.0), (2.0, -1.0), (3.0, -1.0), (3.0, 1.0), (1.0, 1.0)];
        assert!(Polygon::new(straight).unwrap().contains((2.0, 0.0), 0.0));
    }
}
