//! [`Path`]: where a sensor is at a time, to test what estimates it; and [`Mount`], which way its
//! beams go from there.

use std::time::Duration;

use tokio_scip::scan::Pose;

use super::surface::{Vector, millimetres};

/// Path of a sensor: poses at times, with straight lines between them.
///
/// ```
/// use std::time::Duration;
/// use tokio_scip::scan::Pose;
/// use urg_emulator::{Emulator, Path, Scene};
///
/// // Stands for a second, and then drives 2 m in 4 s.
/// let (from, to) = (Pose { x: -1.0, ..Pose::default() }, Pose { x: 1.0, ..Pose::default() });
/// let path = Path::new([(Duration::from_secs(1), from), (Duration::from_secs(5), to)]);
/// assert!(path.pose(Duration::from_secs(3)).x.abs() < 1e-9);
///
/// let room = Scene::new(1).rectangle((-2.0, -2.0), (3.0, 2.0));
/// let emulator = Emulator::builder().world(room.sensor_on(path)).build();
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Path(Vec<(Duration, Pose)>);

impl Path {
    /// Creates a path of poses, each at a time after power-up, in any order. Headings are not
    /// wrapped: from 0 to 2π is a full turn. Without a pose, the sensor stays at the origin.
    pub fn new(poses: impl IntoIterator<Item = (Duration, Pose)>) -> Self {
        let mut poses: Vec<_> = poses.into_iter().collect();
        poses.sort_by_key(|(at, _)| *at);
        Self(poses)
    }

    /// True pose at a time after power-up. The sensor stands before the first pose and after the
    /// last one. It is upside down if the latest pose is.
    ///
    /// [`SentScan::time`](crate::SentScan::time) has the times of a scan and of its rays.
    pub fn pose(&self, time: Duration) -> Pose {
        let next = self.0.partition_point(|(at, _)| *at <= time);
        match (next.checked_sub(1).and_then(|last| self.0.get(last)), self.0.get(next)) {
            (Some((from_at, from)), Some((to_at, to))) => {
                let share = (time - *from_at).as_secs_f64() / (*to_at - *from_at).as_secs_f64();
                let between = |from: f64, to: f64| from + (to - from) * share;
                Pose {
                    x: between(from.x, to.x),
                    y: between(from.y, to.y),
                    heading: between(from.heading, to.heading),
                    upside_down: from.upside_down,
                }
            }
            (Some((_, pose)), None) | (None, Some((_, pose))) => *pose,
            (None, None) => Pose::default(),
        }
    }
}

/// Place of the sensor, and the directions that it calls front and left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mount {
    /// In millimetres.
    pub(super) place: Vector,
    front: Vector,
    left: Vector,
}

impl Mount {
    pub(super) fn at(pose: Pose) -> Self {
        let (sine, cosine) = pose.heading.sin_cos();
        let left = if pose.upside_down { (sine, -cosine) } else { (-sine, cosine) };
        Self { place: millimetres((pose.x, pose.y)), front: (cosine, sine), left }
    }

    /// Returns the direction in the world of a beam, whose direction is in the sensor's frame.
    pub(super) fn direction(&self, (ahead, beside): Vector) -> Vector {
        let Self { front, left, .. } = self;
        (ahead * front.0 + beside * left.0, ahead * front.1 + beside * left.1)
    }
}
