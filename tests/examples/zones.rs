//! The zones of `safety_stop`. In random worlds, which are finer than a step, a clear zone has no
//! obstacle of the promised size, and an empty one is clear. Only walls and outlines make the truth.
//!
//! `SCIP_ZONES=1000000 cargo test --release --test it zones:: -- --nocapture` takes a minute;
//! `SCIP_ZONES_FIRST=1000000` draws others.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use tokio_scip::{Geometry, Measurement, Scan, Window};

use super::programs::safety_stop::zone::Zone;
use crate::common::random::{Random, seeds};
use crate::protocol::geometry::{ug01, utm};

type Spot = (f64, f64);

/// Sensor of a world.
struct Kind {
    geometry: Geometry,
    front: u16,
    /// Codes for weak light, which say nothing about a zone.
    weak: [u32; 4],
    /// Codes, and a distance, for nothing within the range.
    beyond: [u32; 4],
}

impl Kind {
    fn draw(random: &mut Random) -> Self {
        let (geometry, front, weak, beyond) = match random.below(4) {
            0 => (utm(), 540, [2, 3, 4, 5], [1, 1, 1, 60_001]),
            1 => (ug01(), 384, [1, 2, 7, 19], [0, 0, 0, 5601]),
            _ => (Geometry::URG_04LX, 384, [1, 5, 7, 19], [0, 6, 16, 4095]),
        };
        Self { geometry, front, weak, beyond }
    }

    fn step_angle(&self) -> f64 {
        TAU / f64::from(self.geometry.steps_per_revolution())
    }

    fn angle(&self, step: u16) -> f64 {
        (f64::from(step) - f64::from(self.front)) * self.step_angle()
    }

    /// Returns what the sensor sends for a step: the nearest wall there, or a code.
    fn value(&self, walls: &[Wall], step: u16, random: &mut Random) -> u32 {
        let angle = self.angle(step);
        let hits = walls.iter().filter_map(|wall| Some((wall.distance(angle)?, wall.is_weak)));
        let (nearest, farthest) = self.geometry.distances().into_inner();
        match hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, true)) => *random.pick(&self.weak),
            Some((range, false)) if range * 1000.0 <= f64::from(farthest) => {
                ((range * 1000.0).round() as u32).max(nearest)
            }
            _ => *random.pick(&self.beyond),
        }
    }
}

fn between(random: &mut Random, range: RangeInclusive<f64>) -> f64 {
    let share = random.below(1 << 40) as f64 / (1_u64 << 40) as f64;
    range.start() + share * (range.end() - range.start())
}

fn at(angle: f64, range: f64) -> Spot {
    (range * angle.cos(), range * angle.sin())
}

/// Draws the outline of a path from the sensor on, or of a star around a place farther away than the
/// star is large.
fn outline(random: &mut Random) -> Vec<Spot> {
    if random.once_in(2) {
        let (heading, side) = (between(random, -0.7..=0.7), between(random, 0.05..=1.5));
        let far = between(random, 0.1..=3.5);
        let turned = |(x, y): Spot| {
            let (sin, cos) = heading.sin_cos();
            (x * cos - y * sin, x * sin + y * cos)
        };
        return [(0.0, -side), (far, -side), (far, side), (0.0, side)].map(turned).into();
    }
    let distance = between(random, 0.4..=2.0);
    let middle = at(between(random, -1.5..=1.5), distance);
    let corners = 3 + random.below(7);
    let corner = |n| {
        let (x, y) = at(TAU * n as f64 / corners as f64, distance * between(random, 0.3..=0.95));
        (middle.0 + x, middle.1 + y)
    };
    (0..corners).map(corner).collect()
}

/// Adds up the angles that the corners make around the place.
fn contains(outline: &[Spot], place: Spot) -> bool {
    let angle = |corner: Spot| (corner.1 - place.1).atan2(corner.0 - place.0);
    let next = outline.iter().cycle().skip(1);
    let turns = outline.iter().zip(next).map(|(a, b)| angle(*b) - angle(*a));
    let turned: f64 = turns.map(|turn| turn - TAU * (turn / TAU).round()).sum();
    turned.abs() > 1.0
}

/// Returns the largest distance of the outline from the sensor.
fn reach(outline: &[Spot]) -> f64 {
    outline.iter().map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max)
}

/// Straight object that returns light, or only weak light.
struct Wall {
    ends: [Spot; 2],
    is_weak: bool,
}

impl Wall {
    /// Draws a wall of this width as seen from the sensor, at a place.
    fn facing(middle: Spot, width: f64, is_weak: bool) -> Self {
        let range = middle.0.hypot(middle.1);
        let aside = (-middle.1 / range * width / 2.0, middle.0 / range * width / 2.0);
        let ends =
            [(middle.0 - aside.0, middle.1 - aside.1), (middle.0 + aside.0, middle.1 + aside.1)];
        Self { ends, is_weak }
    }

    /// Returns the distance to the wall in a direction.
    fn distance(&self, angle: f64) -> Option<f64> {
        let [(ax, ay), (bx, by)] = self.ends;
        let (sin, cos) = angle.sin_cos();
        let (ex, ey) = (bx - ax, by - ay);
        let across = cos * ey - sin * ex;
        let along = (ax * ey - ay * ex) / across;
        let share = (ax * sin - ay * cos) / across;
        (along > 0.0 && (0.0..=1.0).contains(&share)).then_some(along)
    }

    /// Returns true if all of the wall lies in the outline, a little more than a rounded distance
    /// from its edge.
    fn is_within(&self, outline: &[Spot]) -> bool {
        let [(ax, ay), (bx, by)] = self.ends;
        (0..=40).map(|n| f64::from(n) / 40.0).all(|share| {
            let (x, y) = (ax + share * (bx - ax), ay + share * (by - ay));
            let moved = |share: f64| (x * (1.0 + share), y * (1.0 + share));
            let margin = 0.002 / x.hypot(y);
            [-margin, 0.0, margin].iter().all(|share| contains(outline, moved(*share)))
        })
    }
}

/// One world: what the zone says, and what is true.
struct ZoneCase {
    checked: Result<(), String>,
    has_obstacle: bool,
    /// Nothing stands in the zone or before it, and no code hides a distance.
    is_open: bool,
}

fn case(seed: u64) -> Option<ZoneCase> {
    let random = &mut Random::new(seed);
    let kind = Kind::draw(random);
    let outline = outline(random);
    let reach = reach(&outline);
    let least = reach * kind.step_angle();
    let more = if random.once_in(2) { 0.3 } else { 0.2 * least };
    let width = between(random, least * 1.01..=least * 1.01 + more);
    let zone = Zone::new(kind.geometry, &outline, width).ok()?;
    let cluster = if !random.once_in(3) { 1 } else { 1 + random.below(99) as u8 };

    // Walls anywhere, dropouts, and mostly an obstacle of the promised size or larger.
    let mut walls: Vec<Wall> = Vec::new();
    for _ in 0..random.below(6).saturating_sub(2) {
        let middle = at(between(random, -2.4..=2.4), between(random, 0.05..=6.0));
        walls.push(Wall::facing(middle, between(random, 0.01..=1.5), random.once_in(3)));
    }
    let mut has_obstacle = false;
    if !random.once_in(3) {
        let is_weak = random.once_in(4);
        let edges = [zone.window().start(), zone.window().end()].map(|step| kind.angle(step));
        let wall = (0..20).find_map(|_| {
            let range = between(random, 0.03..=4.0);
            let width = width * between(random, 1.0..=1.5);
            let angle = match random.once_in(2) {
                true => between(random, -2.3..=2.3),
                // The rays are close to where the zone begins or ends, in the middle of a cluster.
                false => {
                    let inwards = width / range * between(random, 0.5..=0.7);
                    *random.pick(&[edges[0] + inwards, edges[1] - inwards])
                }
            };
            let middle = at(angle, range);
            Some(Wall::facing(middle, width, is_weak)).filter(|wall| wall.is_within(&outline))
        });
        has_obstacle = wall.is_some();
        walls.extend(wall);
    }
    let dropouts = random.below(6).saturating_sub(2) * 20;
    let (start, end) = kind.geometry.answered_steps().into_inner();
    let mut raw: Vec<u32> = (0..=end).map(|step| kind.value(&walls, step, random)).collect();
    for _ in 0..dropouts {
        let step = random.below(u64::from(end) + 1) as usize;
        raw[step] = *random.pick(&kind.weak);
    }

    // The zone's own window, or a wider one, or any.
    let (first, last) = (zone.window().start(), zone.window().end());
    let steps = match random.below(4) {
        0 => {
            let mut step = || start + random.below(u64::from(end - start) + 1) as u16;
            let (a, b) = (step(), step());
            a.min(b)..=a.max(b)
        }
        1 => {
            start + random.below(u64::from(first - start) + 1) as u16
                ..=end - random.below(u64::from(end - last) + 1) as u16
        }
        _ => first..=last,
    };
    let window = Window::new(steps.clone()).unwrap().with_cluster_count(cluster).unwrap();
    let steps = usize::from(*steps.start())..=usize::from(*steps.end());
    let clusters = raw[steps].chunks(cluster.into());
    let values: Vec<u32> = clusters.map(|values| *values.iter().min().unwrap()).collect();

    let covers = window.start() <= first && last <= window.end();
    let is_code = |value: &u32| matches!(kind.geometry.measurement(*value), Measurement::Error(_));
    let has_code = raw.iter().any(is_code);
    let no_code_counts = cluster == 1 && dropouts == 0;
    let is_open = covers
        && walls.iter().all(|wall| !wall.is_weak && is_beyond(wall, reach))
        && (no_code_counts || !has_code);
    let checked =
        zone.check(&Scan::builder(window, values).geometry(kind.geometry).build().unwrap());
    Some(ZoneCase { checked, has_obstacle, is_open })
}

/// Returns true if all of a wall is farther away than `reach`.
fn is_beyond(wall: &Wall, reach: f64) -> bool {
    let [(ax, ay), (bx, by)] = wall.ends;
    (0..=40)
        .map(|n| f64::from(n) / 40.0)
        .all(|share| (ax + share * (bx - ax)).hypot(ay + share * (by - ay)) > reach + 0.002)
}

#[test]
fn a_clear_zone_has_no_obstacle() {
    let seeds = seeds("SCIP_ZONES", 500);
    let worlds = seeds.end - seeds.start;
    let (mut clear, mut open, mut blocked) = (0_u64, 0_u64, 0_u64);
    for seed in seeds {
        let Some(ZoneCase { checked, has_obstacle, is_open }) = case(seed) else { continue };
        assert!(!(checked.is_ok() && has_obstacle), "seed {seed}: clear with an obstacle in it");
        assert!(checked.is_ok() || !is_open, "seed {seed}: open, but {checked:?}");
        clear += u64::from(checked.is_ok());
        open += u64::from(is_open);
        blocked += u64::from(has_obstacle);
    }
    println!("{worlds} worlds: {blocked} with an obstacle, {clear} clear, {open} of them open");
    // The worlds are of all kinds.
    assert!(blocked > worlds / 5 && clear > worlds / 10 && open > worlds / 20);
}

/// Returns what a zone of 0.6 m ahead, 0.3 m to each side, finds: all rays measure 2 m, but `rays` of
/// them `value`, in clusters of `cluster` steps.
fn check(rays: RangeInclusive<usize>, value: u32, cluster: u8) -> Result<(), String> {
    let zone =
        Zone::new(Geometry::URG_04LX, &[(0.0, -0.3), (0.6, -0.3), (0.6, 0.3), (0.0, 0.3)], 0.1)
            .unwrap();
    // Steps 128..=640, 180 degrees ahead.
    let window = zone.window().with_cluster_count(cluster).unwrap();
    let mut values = vec![2000; window.points()];
    values[rays].fill(value);
    zone.check(&Scan::builder(window, values).build().unwrap())
}

#[test]
fn an_obstacle_counts_up_to_the_edge() {
    assert_eq!(check(256..=256, 600, 1), Err("obstacle at 0.0°, 0.600 m".into()));
    assert_eq!(check(256..=256, 601, 1), Ok(()));
    // 90 degrees to the right is along an edge.
    assert_eq!(check(0..=0, 300, 1), Err("obstacle at -90.0°, 0.300 m".into()));
    assert_eq!(check(0..=0, 301, 1), Ok(()));
}

#[test]
fn gaps_count_if_the_obstacle_fits() {
    // 0.1 m at the farthest corner, 0.67 m away, covers 24 steps.
    for value in (0..20).chain([4095]) {
        assert_eq!(check(200..=222, value, 1), Ok(()));
        let is_beyond = matches!(value, 0 | 6 | 16 | 4095);
        assert_eq!(check(200..=223, value, 1).is_ok(), is_beyond, "{value}");
        // A code hides the other steps of its cluster.
        assert_eq!(check(50..=54, value, 4), Ok(()));
        assert_eq!(check(50..=55, value, 4).is_ok(), value == 4095, "{value}");
    }
    let reason = "24 rays without a distance up to -11.6°";
    assert_eq!(check(200..=300, 7, 1), Err(reason.into()));
}

#[test]
fn zones_that_are_never_clear_are_refused() {
    let refused = |outline: &[Spot], obstacle| {
        Zone::new(Geometry::URG_04LX, outline, obstacle).err().unwrap()
    };
    let square = [(0.1, -0.3), (0.6, -0.3), (0.6, 0.3), (0.1, 0.3)];
    for obstacle in [f64::NAN, f64::INFINITY, -1.0, 0.0, 0.004] {
        assert_eq!(refused(&square, obstacle), "expected an obstacle of 0.004 m or more");
    }
    for (outline, reason) in [
        (vec![], "no ray crosses the zone"),
        (vec![(3.0, 0.005), (3.001, 0.005), (3.0, 0.006)], "no ray crosses the zone"),
        (vec![(0.015, -0.01), (0.0, 0.0), (0.015, 0.01)], "no ray crosses the zone"),
        (vec![(1.0, -0.5), (5.0, 0.0), (1.0, 0.5)], "the zone reaches 4.1"),
        (vec![(-1.0, -0.5), (-1.0, 0.5), (-2.0, 0.0)], "the zone reaches -180.0°"),
        (vec![(-1.0, -1.0), (1.0, 0.0), (-1.0, 1.0)], "the zone reaches -180.0°"),
        (vec![(f64::NAN, 0.0), (1.0, 0.0), (1.0, 1.0)], "expected finite vertices"),
    ] {
        let refused = refused(&outline, 0.1);
        assert!(refused.starts_with(reason), "{outline:?}: {refused}");
    }
}

#[test]
fn a_scan_must_cover_the_zone() {
    let zone = Zone::new(Geometry::URG_04LX, &[(0.0, 0.0), (1.0, -0.5), (1.0, 0.5)], 0.1).unwrap();
    let window = Window::degrees(0.0..=90.0).unwrap();
    let scan = Scan::builder(window, vec![2000; window.points()]).build().unwrap();
    let expected = "the zone needs steps 309..=459, the scan has steps 384..=640";
    assert_eq!(zone.check(&scan), Err(expected.into()));
}

#[test]
fn a_scan_of_another_model_does_not_count() {
    let zone = Zone::new(utm(), &[(0.0, 0.0), (1.0, -0.5), (1.0, 0.5)], 0.1).unwrap();
    let window = zone.window();
    let scan = Scan::builder(window, vec![2000; window.points()]);
    assert_eq!(zone.check(&scan.clone().geometry(utm()).build().unwrap()), Ok(()));
    assert_eq!(zone.check(&scan.build().unwrap()), Err("the scan is of another model".to_owned()));
}
