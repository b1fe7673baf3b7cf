//! Shows sensors live in Rerun, all in the frame of the vehicle:
//!
//! ```sh
//! pip install rerun-sdk
//! cd examples/rerun
//! cargo run emulated@0.2,0,0 emulated@-0.2,0,180
//! cargo run serial:H0713090@0.2,0,0 serial:H0713091@-0.2,0,180
//! cargo run -- --save run.rrd emulated@0,0,0
//! ```
//!
//! Each sensor has its place: metres ahead, metres to the left, degrees counter-clockwise. With
//! `--save` the scans go to a file, and no viewer starts.

use std::error::Error;
use std::time::{Duration, UNIX_EPOCH};

use futures::future::try_join_all;
use rerun::{
    Arrows3D, Color, LineStrips3D, Points3D, RecordingStream, RecordingStreamBuilder, TextLog,
    TextLogLevel, ViewCoordinates,
};
use tokio_scip::scan::Pose;
use tokio_scip::{ErrorChain, Rate, Scan, Sensor, Window};
use urg_emulator::{Emulator, Room};

/// The viewer orders the scans by the time of their first ray.
const TIMELINE: &str = "first_ray";
/// Colours of the sensors, in turn.
const COLORS: [(u8, u8, u8); 4] = [(80, 200, 120), (90, 160, 255), (255, 170, 60), (230, 110, 220)];

/// Sensor, its place, and what it is called in the viewer.
struct Mounted {
    name: String,
    color: Color,
    pose: Pose,
    sensor: Sensor,
}

/// Opens the sensor of `PORT@X,Y,DEGREES`.
async fn mount(number: usize, argument: String) -> Result<Mounted, Box<dyn Error>> {
    let expected = || format!("expected PORT@X,Y,DEGREES, found {argument}");
    let (port, place) = argument.rsplit_once('@').ok_or_else(expected)?;
    let place: Vec<f64> = place.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let &[x, y, degrees] = place.as_slice() else { return Err(expected().into()) };
    let builder = Sensor::builder().name(port);
    let sensor = if port == "emulated" {
        // Both stand in the same room.
        let (sensor, driver) = builder.build(Emulator::builder().world(Room::new(0)).build());
        tokio::spawn(driver);
        sensor
    } else {
        builder.wait_for_sensor(true).open(port).await?
    };
    Ok(Mounted {
        name: format!("vehicle/sensor_{number}"),
        color: COLORS[number % COLORS.len()].into(),
        pose: Pose { x, y, heading: degrees.to_radians(), ..Pose::default() },
        sensor,
    })
}

impl Mounted {
    /// Logs where the sensor is and looks, once for all times.
    fn log_place(&self, viewer: &RecordingStream) -> Result<(), Box<dyn Error>> {
        let (x, y) = self.pose.transform(0.0, 0.0);
        let (ahead_x, ahead_y) = self.pose.transform(0.2, 0.0);
        let arrow = Arrows3D::from_vectors([[(ahead_x - x) as f32, (ahead_y - y) as f32, 0.0]])
            .with_origins([[x as f32, y as f32, 0.0]])
            .with_colors([self.color]);
        Ok(viewer.log_static(format!("{}/place", self.name), &arrow)?)
    }

    /// Logs scans and errors until the driver stops.
    async fn log_scans(&self, viewer: &RecordingStream) -> Result<(), Box<dyn Error>> {
        let mut scans = self.sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
        while let Some(scan) = scans.next().await {
            match scan {
                Ok(scan) => self.log_scan(viewer, &scan)?,
                // The stream continues.
                Err(error) => {
                    let text = TextLog::new(ErrorChain(&error).to_string());
                    let path = format!("{}/errors", self.name);
                    viewer.log(path, &text.with_level(TextLogLevel::WARN))?;
                }
            }
        }
        Ok(())
    }

    /// Logs a scan twice: its points, and lines from ray to ray. A ray without a distance ends
    /// a line.
    fn log_scan(&self, viewer: &RecordingStream, scan: &Scan) -> Result<(), Box<dyn Error>> {
        let rays: Vec<Option<[f32; 3]>> =
            scan.rays().map(|ray| self.place_of(ray.point()?)).collect();
        let lines = rays.split(Option::is_none).filter(|line| line.len() > 1);
        let lines = lines.map(|line| line.iter().copied().flatten());
        let since_1970 = scan.first_ray_stamp().duration_since(UNIX_EPOCH)?;
        let nanoseconds = i64::try_from(since_1970.as_nanos())?;
        viewer.set_timestamp_nanos_since_epoch(TIMELINE, nanoseconds);
        let points = Points3D::new(rays.iter().copied().flatten());
        let points = points.with_colors([self.color]).with_radii([0.01]);
        viewer.log(format!("{}/points", self.name), &points)?;
        let lines = LineStrips3D::new(lines).with_colors([self.color]);
        Ok(viewer.log(format!("{}/outline", self.name), &lines)?)
    }

    /// Returns a point in the frame of the vehicle.
    fn place_of(&self, point: tokio_scip::Point) -> Option<[f32; 3]> {
        let (x, y) = self.pose.transform(point.x, point.y);
        Some([x as f32, y as f32, 0.0])
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).peekable();
    let viewer = RecordingStreamBuilder::new("tokio-scip");
    let viewer = match arguments.next_if_eq("--save") {
        Some(_) => viewer.save(arguments.next().ok_or("expected a file after --save")?)?,
        None => viewer.spawn()?,
    };
    let mounting = arguments.enumerate().map(|(n, argument)| mount(n, argument));
    let sensors = try_join_all(mounting).await?;
    // x ahead, y to the left, as in ROS.
    viewer.log_static("vehicle", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    sensors.iter().try_for_each(|sensor| sensor.log_place(&viewer))?;
    let logged = try_join_all(sensors.iter().map(|sensor| sensor.log_scans(&viewer)));
    tokio::select! {
        ended = logged => drop(ended?),
        interrupted = tokio::signal::ctrl_c() => interrupted?,
    }
    viewer.flush_with_timeout(Duration::from_secs(5))?;
    Ok(())
}
