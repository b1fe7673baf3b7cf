//! Zones in random worlds, which are finer than a step: a zone that says clear has no obstacle of
//! the promised size, and one without anything in it says clear. The truth is computed from the
//! walls alone.
//!
//! `SCIP_ZONES=1000000 cargo test --release --test it zones:: -- --nocapture` takes a minute;
//! `SCIP_ZONES_FIRST=1000000` draws others.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use tokio_scip::scan::{CountsAs, Zone, ZoneState};
use tokio_scip::{Scan, Window};

use crate::common::random::{Random, seeds};

type Spot = (f64, f64);

/// Codes for weak light, which say nothing about a zone.
const WEAK: [u16; 4] = [1, 5, 7, 19];
/// Codes, and a distance, for nothing within the range.
const BEYOND: [u16; 4] = [0, 6, 16, 4095];

fn between(random: &mut Random, range: RangeInclusive<f64>) -> f64 {
    let share = random.below(1 << 40) as f64 / (1_u64 << 40) as f64;
    range.start() + share * (range.end() - range.start())
}

fn at(angle: f64, range: f64) -> Spot {
    (range * angle.cos(), range * angle.sin())
}

/// Area of a zone, by code that the library does not share.
enum Area {
    Sector { from: f64, to: f64, near: f64, far: f64 },
    Polygon(Vec<Spot>),
}

impl Area {
    fn draw(random: &mut Random) -> Self {
        if random.once_in(2) {
            let (a, b) = (between(random, -2.3..=2.3), between(random, -2.3..=2.3));
            let near = if random.once_in(2) { 0.0 } else { between(random, 0.1..=1.0) };
            let far = (near + between(random, 0.1..=3.2)).min(4.09);
            return Self::Sector { from: a.min(b), to: a.max(b), near, far };
        }
        // A star around a place that is farther away than the star is large.
        let distance = between(random, 0.4..=2.0);
        let middle = at(between(random, -1.5..=1.5), distance);
        let corners = 3 + random.below(7);
        let corner = |n| {
            let (x, y) =
                at(TAU * n as f64 / corners as f64, distance * between(random, 0.3..=0.95));
            (middle.0 + x, middle.1 + y)
        };
        Self::Polygon((0..corners).map(corner).collect())
    }

    fn zone(&self) -> Option<Zone> {
        match self {
            Self::Sector { from, to, near, far } => {
                Zone::sector(from.to_degrees()..=to.to_degrees(), *near..=*far).ok()
            }
            Self::Polygon(corners) => Zone::polygon(corners.iter().copied()).ok(),
        }
    }

    fn contains(&self, place: Spot) -> bool {
        match self {
            Self::Sector { from, to, near, far } => {
                let (range, angle) = (place.0.hypot(place.1), place.1.atan2(place.0));
                *near <= range && range <= *far && *from <= angle && angle <= *to
            }
            Self::Polygon(corners) => {
                // Adds up the angles that the corners make around the place.
                let angle = |corner: Spot| (corner.1 - place.1).atan2(corner.0 - place.0);
                let next = corners.iter().skip(1).chain(corners.first());
                let turns = corners.iter().zip(next).map(|(a, b)| angle(*b) - angle(*a));
                let turned: f64 = turns.map(|turn| turn - TAU * (turn / TAU).round()).sum();
                turned.abs() > 1.0
            }
        }
    }

    /// Returns the largest distance of the area from the sensor.
    fn reach(&self) -> f64 {
        match self {
            Self::Sector { far, .. } => *far,
            Self::Polygon(corners) => corners.iter().map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max),
        }
    }
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

    /// Returns true if all of the wall lies in the area, a little more than a rounded distance
    /// from its edge.
    fn is_within(&self, area: &Area) -> bool {
        let [(ax, ay), (bx, by)] = self.ends;
        (0..=40).map(|n| f64::from(n) / 40.0).all(|share| {
            let (x, y) = (ax + share * (bx - ax), ay + share * (by - ay));
            let moved = |share: f64| (x * (1.0 + share), y * (1.0 + share));
            let margin = 0.002 / x.hypot(y);
            [-margin, 0.0, margin].iter().all(|share| area.contains(moved(*share)))
        })
    }
}

fn angle(step: u16) -> f64 {
    (f64::from(step) - 384.0) * TAU / 1024.0
}

/// Returns what the sensor sends for a step: the nearest wall there, or a code.
fn value(walls: &[Wall], step: u16, random: &mut Random) -> u16 {
    let angle = angle(step);
    let hits = walls.iter().filter_map(|wall| Some((wall.distance(angle)?, wall.is_weak)));
    match hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((_, true)) => *random.pick(&WEAK),
        Some((range, false)) if range <= 4.094 => ((range * 1000.0).round() as u16).max(20),
        _ => *random.pick(&BEYOND),
    }
}

/// One world: what the zone says, and what is true.
struct ZoneCase {
    state: ZoneState,
    has_obstacle: bool,
    /// Nothing stands in the zone or before it, and no code hides a distance.
    is_open: bool,
}

fn case(seed: u64) -> Option<ZoneCase> {
    let random = &mut Random::new(seed);
    let area = Area::draw(random);
    let least = area.reach() * TAU / 1024.0;
    let more = if random.once_in(2) { 0.3 } else { 0.2 * least };
    let width = between(random, least * 1.01..=least * 1.01 + more);
    let mut zone = area.zone()?.smallest_obstacle(width).unwrap();
    let counts_as = if random.once_in(4) { CountsAs::Unknown } else { CountsAs::Free };
    zone = zone.beyond_range(counts_as);
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
        let edges = [zone.window().start(), zone.window().end()].map(|step| angle(step.number()));
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
            Some(Wall::facing(middle, width, is_weak)).filter(|wall| wall.is_within(&area))
        });
        has_obstacle = wall.is_some();
        walls.extend(wall);
    }
    let dropouts = random.below(6).saturating_sub(2) * 20;
    let mut raw: Vec<u16> = (0..=768).map(|step| value(&walls, step, random)).collect();
    for _ in 0..dropouts {
        let step = random.below(769) as usize;
        raw[step] = *random.pick(&WEAK);
    }

    // The zone's own window, or a wider one, or any.
    let (first, last) = (zone.window().start().number(), zone.window().end().number());
    let steps = match random.below(4) {
        0 => {
            let (a, b) = (random.below(769) as u16, random.below(769) as u16);
            a.min(b)..=a.max(b)
        }
        1 => {
            random.below(u64::from(first) + 1) as u16
                ..=768 - random.below(769 - u64::from(last)) as u16
        }
        _ => first..=last,
    };
    let window = Window::new(steps.clone()).unwrap().with_cluster_count(cluster).unwrap();
    let steps = usize::from(*steps.start())..=usize::from(*steps.end());
    let clusters = raw[steps].chunks(cluster.into());
    let values: Vec<u16> = clusters.map(|values| *values.iter().min().unwrap()).collect();

    let covers = window.start().number() <= first && last <= window.end().number();
    let has_code = raw.iter().any(|value| *value < 20);
    let no_code_counts = cluster == 1 && counts_as == CountsAs::Free && dropouts == 0;
    let is_open = covers
        && walls.iter().all(|wall| !wall.is_weak && is_beyond(wall, area.reach()))
        && (no_code_counts || !has_code);
    let state = zone.check(&Scan::builder(window, values).build().unwrap());
    Some(ZoneCase { state, has_obstacle, is_open })
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
        let Some(ZoneCase { state, has_obstacle, is_open }) = case(seed) else { continue };
        assert!(!(state.is_clear() && has_obstacle), "seed {seed}: clear with an obstacle in it");
        assert!(state.is_clear() || !is_open, "seed {seed}: open, but {state}");
        clear += u64::from(state.is_clear());
        open += u64::from(is_open);
        blocked += u64::from(has_obstacle);
    }
    println!("{worlds} worlds: {blocked} with an obstacle, {clear} clear, {open} of them open");
    // The worlds are of all kinds.
    assert!(blocked > worlds / 5 && clear > worlds / 10 && open > worlds / 20);
}
