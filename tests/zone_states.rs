//! What a zone reports of scans. `tests/zones.rs` checks in random worlds when it is clear.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use tokio_scip::scan::{CountsAs, Zone, ZoneError, ZoneState};
use tokio_scip::{Scan, Window};

/// Steps 128..=640, 180 degrees ahead.
fn half() -> Window {
    Window::degrees(-90.0..=90.0).unwrap()
}

fn scan(window: Window, values: Vec<u16>) -> Scan {
    Scan::builder(window, values).build().unwrap()
}

/// Returns a scan of `half` that measures 2 m, but `value` in these steps.
fn with(steps: RangeInclusive<u16>, value: u16) -> Scan {
    let value = |step| if steps.contains(&step) { value } else { 2000 };
    scan(half(), (128..=640).map(value).collect())
}

fn sector(degrees: f64, range: RangeInclusive<f64>) -> Zone {
    Zone::sector(-degrees..=degrees, range).unwrap()
}

/// Tolerates `rays` consecutive unknown rays at 0.6 m.
fn tolerant(zone: &Zone, rays: usize) -> Zone {
    let angle = (rays as f64 + 1.5) * TAU / 1024.0;
    zone.clone().smallest_obstacle(2.0 * 0.6 * (angle / 2.0).tan()).unwrap()
}

/// Returns the number of consecutive unknown rays that a zone tolerates ahead.
fn tolerated(zone: &Zone, window: Window) -> usize {
    let from = (384 - 128) / usize::from(window.cluster_count());
    let is_clear = |rays: &usize| {
        let mut values = vec![2000; window.points()];
        values[from..from + rays].fill(7);
        zone.check(&scan(window, values)).is_clear()
    };
    (0..).take_while(is_clear).last().unwrap()
}

/// Returns first and last step of the gap and its rays.
fn blind(state: ZoneState) -> (u16, u16, usize) {
    let ZoneState::Blind { first, last, rays, .. } = state else { panic!("{state:?}") };
    (first.step.number(), last.step.number(), rays)
}

fn obstacle(state: ZoneState) -> u16 {
    let ZoneState::Obstacle(ray) = state else { panic!("{state:?}") };
    ray.step.number()
}

#[test]
fn an_obstacle_is_found_at_its_nearest_ray() {
    // Steps 299..=469.
    let zone = sector(30.0, 0.0..=0.6);
    assert_eq!(zone.check(&with(384..=384, 601)), ZoneState::Clear);
    assert_eq!(obstacle(zone.check(&with(384..=384, 600))), 384);
    assert_eq!(obstacle(zone.check(&with(299..=299, 20))), 299);
    assert_eq!(zone.check(&with(298..=298, 20)), ZoneState::Clear);
    let mut values = vec![2000; 513];
    (values[172], values[260], values[300]) = (500, 400, 400);
    // It is the first of two that are equally near.
    assert_eq!(obstacle(zone.check(&scan(half(), values))), 388);
}

#[test]
fn a_gap_is_tolerated_up_to_its_number_of_rays() {
    let zone = sector(30.0, 0.0..=0.6);
    for rays in 1..20 {
        let scan = with(400..=399 + rays, 7);
        assert!(tolerant(&zone, rays.into()).check(&scan).is_clear());
        let state = tolerant(&zone, usize::from(rays) - 1).check(&scan);
        assert_eq!(blind(state), (400, 399 + rays, rays.into()));
    }
    // A free ray ends a gap, and the longest gap is reported.
    let mut values = vec![2000; 513];
    values[200..240].fill(7);
    (values[210], values[225]) = (700, 700);
    let scan = scan(half(), values);
    assert_eq!(blind(tolerant(&zone, 9).check(&scan)), (339, 352, 14));
    assert!(tolerant(&zone, 14).check(&scan).is_clear());
    // A gap counts only inside the zone.
    let zone = tolerant(&sector(30.0, 0.0..=0.6), 9);
    assert!(zone.check(&with(461..=500, 7)).is_clear());
    assert_eq!(blind(zone.check(&with(460..=500, 7))), (460, 469, 10));
}

#[test]
fn each_error_code_counts_as_it_is_set() {
    let zone = sector(30.0, 0.0..=0.6);
    let trusting = zone.clone().beyond_range(CountsAs::Free);
    for value in (0..20).chain([4095]) {
        let scan = with(384..=384, value);
        assert_eq!(blind(zone.check(&scan)), (384, 384, 1), "{value}");
        let is_beyond = matches!(value, 0 | 6 | 16 | 4095);
        assert_eq!(trusting.check(&scan).is_clear(), is_beyond, "{value}");
        let strict = zone.clone().beyond_range(CountsAs::Obstacle).check(&scan);
        assert_eq!(matches!(strict, ZoneState::Obstacle(_)), is_beyond, "{value}");
    }
}

#[test]
fn zones_that_can_never_be_clear_are_refused() {
    let refused = |from: f64, to: f64, far: f64| Zone::sector(from..=to, 0.0..=far).unwrap_err();
    for (from, to) in [(-135.1, 0.0), (0.0, 135.1), (30.0, -30.0), (f64::NAN, 0.0), (0.0, f64::NAN)]
    {
        let text = format!(
            "invalid sector from {from} to {to} degrees: expected -135 to 135, the smaller one first"
        );
        assert_eq!(refused(from, to, 0.6).to_string(), text);
    }
    assert!(matches!(refused(-30.0, 30.0, 4.095), ZoneError::BeyondRange { .. }));
    assert_eq!(refused(0.1, 0.2, 0.6), ZoneError::BetweenRays);
    assert_eq!(refused(-30.0, 30.0, 0.02), ZoneError::BetweenRays);
    let polygon = |vertices: [(f64, f64); 3]| Zone::polygon(vertices).unwrap_err();
    assert_eq!(polygon([(3.0, 0.005), (3.001, 0.005), (3.0, 0.006)]), ZoneError::BetweenRays);
    assert_eq!(polygon([(-1.0, -1.0), (1.0, 0.0), (-1.0, 1.0)]), ZoneError::SensorInside);
    let behind = polygon([(-1.0, -0.5), (-1.0, 0.5), (-2.0, 0.0)]);
    assert!(behind.to_string().starts_with("the zone reaches -1"), "{behind}");
    let far = polygon([(1.0, -0.5), (5.0, 0.0), (1.0, 0.5)]);
    assert!(matches!(far, ZoneError::BeyondRange { .. }), "{far}");
}

#[test]
fn a_polygon_does_not_surround_the_sensor() {
    let path = |back: f64| [(back, -0.3), (1.0, -0.3), (1.0, 0.3), (back, 0.3)];
    let zone = Zone::polygon(path(0.0)).unwrap();
    assert_eq!(zone.check(&with(0..=0, 0)), ZoneState::Clear);
    // 90 degrees to the right is along an edge, and 1 m ahead is on one.
    assert_eq!(obstacle(zone.check(&with(128..=128, 300))), 128);
    assert_eq!(zone.check(&with(128..=128, 301)), ZoneState::Clear);
    assert_eq!(obstacle(zone.check(&with(384..=384, 1000))), 384);
    assert_eq!(zone.check(&with(384..=384, 1001)), ZoneState::Clear);
    let all = scan(Window::FULL, vec![4000; 769]);
    assert_eq!(Zone::polygon(path(-0.1)), Err(ZoneError::SensorInside));
    let triangle = Zone::polygon([(0.0, 0.0), (1.0, -0.5), (1.0, 0.5)]).unwrap();
    assert!(triangle.check(&all).is_clear());
}

#[test]
fn the_smallest_obstacle_covers_more_rays_than_are_tolerated() {
    let rays = |width: f64, cluster: u8| {
        let window = half().with_cluster_count(cluster).unwrap();
        tolerated(&sector(30.0, 0.0..=0.6).smallest_obstacle(width).unwrap(), window)
    };
    assert_eq!((rays(0.1, 1), rays(0.1, 4), rays(0.1, 99)), (26, 6, 0));
    for hostile in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e-9, 0.0036] {
        let refused = sector(30.0, 0.0..=0.6).smallest_obstacle(hostile).unwrap_err();
        assert!(refused.to_string().ends_with("expected at least 0.004 m"), "{refused}");
    }
    // A polygon by its farthest vertex.
    let square = Zone::polygon([(0.0, -0.3), (0.4, -0.3), (0.4, 0.3), (0.0, 0.3)]).unwrap();
    assert_eq!(tolerated(&square.smallest_obstacle(0.1).unwrap(), half()), 31);
}

#[test]
fn a_range_that_contains_nothing_is_refused() {
    for range in
        [0.5..=0.5, 0.6..=0.5, -0.1..=0.5, f64::NAN..=0.5, 0.0..=f64::NAN, 0.0..=f64::INFINITY]
    {
        let refused = Zone::sector(-90.0..=90.0, range.clone());
        assert!(matches!(refused, Err(ZoneError::Range { .. })), "{range:?}");
    }
}

#[test]
fn a_state_says_where_and_why() {
    let zone = sector(30.0, 0.0..=0.6);
    let strict = zone.clone().beyond_range(CountsAs::Obstacle);
    let text = |zone: &Zone, scan: &Scan| zone.check(scan).to_string();
    assert_eq!(text(&zone, &with(0..=0, 0)), "clear");
    assert_eq!(text(&zone, &with(400..=400, 500)), "obstacle at 5.6°, 0.500 m");
    let expected = "obstacle at 5.6°: error code 6: Possibility of detected object is at 5.7m";
    assert_eq!(text(&strict, &with(400..=400, 6)), expected);
    assert_eq!(text(&zone, &with(400..=410, 3)), "blind from 5.6° to 9.1°, 11 rays");
    let expected = "no ray at -99.8°: the zone needs steps 100..=668";
    assert_eq!(text(&sector(100.0, 0.0..=0.6), &with(0..=0, 0)), expected);
}
