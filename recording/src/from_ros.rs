//! [`MessageScan`]: what a `/scan` message tells about the reply that it was made of. Recordings
//! without replies have nothing else.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::time::{Duration, SystemTime};

use super::reply::Values;
use super::stream::{Model, Stream};
use crate::ros::LaserScan;
use tokio_scip::protocol::scip2::Parameters;
use tokio_scip::{Geometry, Scan, Window};

/// Largest sum of the differences of three angles from their steps, in steps. Other laser scanners have other angles.
const TOLERANCE: f64 = 0.01;
/// Largest difference of a limit of the ranges from the sensor's, in millimetres. This crate writes
/// limits that are a millimetre farther, other programs the sensor's own.
const LIMIT_TOLERANCE: f64 = 1.5;
/// Steps in a revolution: of a URG, of a UTM or UST, and of a UST-10LX-H01, -H02 or UXM-30LX-EW.
const RESOLUTIONS: [u16; 3] = [1024, 1440, 2880];
/// Largest distance of 18 bits, in millimetres.
const LONGEST: f64 = 262_143.0;
/// Motors turn once in 25 to 200 ms. A time beyond these limits is in another unit, or is none.
const REVOLUTIONS: RangeInclusive<f32> = 0.001..=1.0;
/// Revolutions from scan to scan: a sensor can skip nine scans.
const TURNS: RangeInclusive<f32> = 1.0..=10.0;

/// Scan of a sensor of Hokuyo, as far as a message has it.
#[derive(Debug)]
pub(super) struct MessageScan {
    pub(super) stream: Stream,
    pub(super) values: Values,
    /// Wall clock at the end of the revolution: when the reply arrived, unless it was late.
    pub(super) stamp: SystemTime,
    /// Time of one revolution, if the message has it.
    pub(super) scan_time: Option<Duration>,
}

impl MessageScan {
    /// Converts a message. `known` are the recorded streams, because a message does not tell how many
    /// steps its last point has, nor all of its sensor. Returns `None` if the message has other
    /// directions than the steps of a sensor.
    pub(super) fn from_message(
        message: &LaserScan,
        known: impl IntoIterator<Item = Stream>,
    ) -> Option<Self> {
        let known = known.into_iter().filter(|stream| has_limits(message, &stream.model));
        let assumed = RESOLUTIONS.into_iter().filter_map(|resolution| assumed(message, resolution));
        let assumed = assumed.flat_map(|model| {
            let windows = [by_definition(message, &model), by_steps(message, &model)];
            let stream = move |window| Stream { model: model.clone(), window };
            windows.into_iter().flatten().map(stream)
        });
        let stream = known.chain(assumed).find(|stream| is_of(message, stream))?;
        let geometry = stream.model.geometry();
        let distances: Vec<u32> =
            message.ranges.iter().map(|range| value(*range, &geometry)).collect();
        let scan_time = revolution(message).map(Duration::from_secs_f32);
        let scan = Scan::builder(stream.window, distances.as_slice()).geometry(geometry);
        let mut scan = scan.stamp(message.stamp);
        if let Some(time) = scan_time {
            scan = scan.scan_time(time);
        }
        let first_ray = scan.build().ok()?.first_ray_stamp();
        let until_end = message.stamp.duration_since(first_ray).unwrap_or_default();
        let stamp = message.stamp.checked_add(until_end)?;
        let values = Values { distances, intensities: intensities(message), clock: None };
        Some(Self { stream, values, stamp, scan_time })
    }

    /// Describes the directions of a message.
    pub(super) fn directions(message: &LaserScan) -> String {
        let angles = [message.angle_min, message.angle_max, message.angle_increment];
        let ([from, to, by], points) = (angles.map(f32::to_degrees), message.ranges.len());
        format!("{points} points from {from:.2}° to {to:.2}° every {by:.3}°")
    }
}

/// Seconds of one revolution, if the message has them. `hokuyo_node` writes the time between two
/// scans: of several revolutions if the sensor skips scans. The time between two points tells.
fn revolution(message: &LaserScan) -> Option<f32> {
    let turn = message.time_increment * std::f32::consts::TAU / message.angle_increment;
    let turns = (message.scan_time / turn).round();
    let turns = if TURNS.contains(&turns) { turns } else { 1.0 };
    Some(message.scan_time / turns).filter(|time| REVOLUTIONS.contains(time))
}

/// Intensities of a message, unless they are none of a sensor: whole numbers of 18 bits, one for each range.
fn intensities(message: &LaserScan) -> Vec<u32> {
    let is_one = |value: &f32| (0.0..=LONGEST as f32).contains(value) && value.fract() == 0.0;
    let intensities = &message.intensities;
    let are_own = intensities.len() == message.ranges.len() && intensities.iter().all(is_one);
    intensities.iter().filter(|_| are_own).map(|value| *value as u32).collect()
}

/// Returns true if the message has the sensor's limits of the ranges, or none.
fn has_limits(message: &LaserScan, model: &Model) -> bool {
    let (least, most) = model.geometry().distances().into_inner();
    limits(message).is_none_or(|[min, max]| {
        (min - f64::from(least)).abs() <= LIMIT_TOLERANCE
            && (max - f64::from(most)).abs() <= LIMIT_TOLERANCE
    })
}

/// Limits of the ranges in millimetres, if the message has some.
fn limits(message: &LaserScan) -> Option<[f64; 2]> {
    let [min, max] = [message.range_min, message.range_max].map(|limit| f64::from(limit) * 1000.0);
    (0.0..max).contains(&min).then_some([min, max]).filter(|_| max <= LONGEST)
}

/// Sensor of this number of steps in a revolution, as far as the limits of the ranges tell it. Only a
/// UXM reaches farther than a UST's error code. No known sensor measures before -135 degrees.
fn assumed(message: &LaserScan, resolution: u16) -> Option<Model> {
    let [min, max] = limits(message).unwrap_or([20.0, 60_000.0]);
    if resolution == 1024 && (has_limits(message, &Model::default())) {
        return Some(Model::default());
    }
    let (name, usual) = if resolution == 1024 { ("URG", 600) } else { ("UST", 2400) };
    let name = if max > 65_533.0 { "UXM" } else { name };
    // Nominal, where the message has a measured time.
    let speed = revolution(message).map_or(usual, |time| (0.6 / time).round() as u32 * 100);
    let numbers = [
        ("DMIN", min.max(1.0).round() as u32),
        ("DMAX", max.round() as u32),
        ("ARES", resolution.into()),
        ("AMIN", 0),
        ("AMAX", u32::from(resolution) / 4 * 3),
        ("AFRT", u32::from(resolution) / 8 * 3),
        ("SCAN", speed),
    ];
    let pairs = numbers.map(|(key, number)| (key, number.to_string()));
    let pairs = pairs.iter().map(|(key, number)| (*key, &**number));
    Parameters::from_pairs(pairs.chain([("MODL", name)])).ok().map(Model::from)
}

/// Directions of the first and the last point of a window, in steps.
pub(super) fn ends(window: &Window) -> [f64; 2] {
    let cluster = f64::from(window.cluster_count());
    let first = f64::from(window.start());
    let middle = first + (cluster.min(window.steps() as f64) - 1.0) / 2.0;
    [middle, middle + cluster * (window.points() - 1) as f64]
}

/// Returns true if a message has the directions of a stream, but for rounding errors: by the definition of a
/// `LaserScan`, or as `urg_node` writes them, which takes the first and the last step.
fn is_of(message: &LaserScan, Stream { model, window }: &Stream) -> bool {
    let geometry = model.geometry();
    let [first, last] = [message.angle_min, message.angle_max].map(|angle| step(angle, &geometry));
    let by = steps(message.angle_increment, &geometry) - f64::from(window.cluster_count());
    let is_near =
        |[ours, end]: [f64; 2]| by.abs() + (ours - first).abs() + (end - last).abs() < TOLERANCE;
    window.points() == message.ranges.len()
        && (is_near(ends(window)) || is_near([window.start().into(), window.end().into()]))
}

/// Window whose first point has the direction of `angle_min`, if there is one. Its last point has
/// all steps of its cluster that exist.
fn by_definition(message: &LaserScan, model: &Model) -> Option<Window> {
    let (geometry, cluster) = (model.geometry(), cluster(message, model)?);
    let start = whole(step(message.angle_min, &geometry) - f64::from(cluster - 1) / 2.0)?;
    let steps = u16::try_from(message.ranges.len()).ok()?.checked_mul(cluster.into())?;
    let end = start.checked_add(steps.checked_sub(1)?)?.min(*geometry.answered_steps().end());
    model.window(start, end, cluster)
}

/// Window from the step at `angle_min` to the step at `angle_max`, if there is one.
fn by_steps(message: &LaserScan, model: &Model) -> Option<Window> {
    let geometry = model.geometry();
    let end = |angle| whole(step(angle, &geometry));
    model.window(end(message.angle_min)?, end(message.angle_max)?, cluster(message, model)?)
}

fn cluster(message: &LaserScan, model: &Model) -> Option<u8> {
    let cluster = whole(steps(message.angle_increment, &model.geometry()))?;
    cluster.try_into().ok().filter(|cluster| *cluster > 0)
}

/// Converts an angle in radians to a number of steps.
fn steps(angle: f32, geometry: &Geometry) -> f64 {
    f64::from(angle) / TAU * f64::from(geometry.steps_per_revolution())
}

/// Step in the direction of an angle in radians.
fn step(angle: f32, geometry: &Geometry) -> f64 {
    steps(angle, geometry) - steps(geometry.degrees(0).to_radians(), geometry)
}

fn whole(number: f64) -> Option<u16> {
    // The cast turns NaN into 0, and other numbers into the nearest one.
    let whole = number.round() as u16;
    ((f64::from(whole) - number).abs() <= 0.5).then_some(whole)
}

/// Returns the value that a sensor sends for a range. `urg_node` and `hokuyo_node` write an error code
/// as a range of as many millimetres: it becomes that code.
fn value(range: f32, geometry: &Geometry) -> u32 {
    let millimetres = (f64::from(range) * 1000.0).round();
    match millimetres {
        far if far > f64::from(*geometry.distances().end()) => geometry.far_value(),
        millimetres if millimetres >= 0.0 => millimetres as u32,
        _ => geometry.unknown_value(),
    }
}
