//! Poses of sensors in the common frame, as the command line and the page write them: X,Y,YAW
//! in metres and degrees, with `,upside-down` if they are.

use std::f64::consts::PI;

use tokio_scip::scan::Pose;

/// Last part of a pose that is turned over.
const UPSIDE_DOWN: &str = "upside-down";

/// Maximum distance from the origin along each axis, in metres.
pub(crate) const FARTHEST: f64 = 1000.0;

/// Parses distances, then YAW, `YAW,upside-down` or `YAW,PITCH,ROLL` in degrees. Returns metres, and
/// roll, pitch and yaw in radians, which tf2 applies in this order.
pub(crate) fn distances_and_angles<const N: usize>(text: &str) -> Option<([f64; N], [f64; 3])> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let (distances, angles) = parts.split_at_checked(N)?;
    let within =
        |text: &str, most: f64| text.parse().ok().filter(|number: &f64| number.abs() <= most);
    let angle = |degrees| Some(within(degrees, 360.0)?.to_radians());
    let angles = match *angles {
        [yaw] => [0.0, 0.0, angle(yaw)?],
        [yaw, UPSIDE_DOWN] => [PI, 0.0, angle(yaw)?],
        [yaw, pitch, roll] => [angle(roll)?, angle(pitch)?, angle(yaw)?],
        _ => return None,
    };
    let distances = distances.iter().map(|metres| within(metres, FARTHEST));
    let distances: Vec<f64> = distances.collect::<Option<_>>()?;
    Some((distances.try_into().ok()?, angles))
}

/// Parses the pose of a sensor that scans the plane of the common frame.
pub(crate) fn parse(text: &str) -> Result<Pose, String> {
    match distances_and_angles(text) {
        Some(([x, y], [roll, 0.0, heading])) if roll == 0.0 || roll.abs() == PI => {
            Ok(Pose { x, y, heading, upside_down: roll != 0.0 })
        }
        _ => Err(format!(
            "invalid place `{text}`: expected X,Y,YAW in metres and degrees, such as 0.2,0,90, \
             at most {FARTHEST} m and 360°, and `,{UPSIDE_DOWN}` after it for a sensor that is"
        )),
    }
}

/// Returns the heading in degrees, as it was parsed.
pub(crate) fn yaw(pose: Pose) -> f64 {
    // Without what the way over radians has changed.
    (pose.heading.to_degrees() * 1e9).round() / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_yaw_is_written_as_it_was_parsed() {
        for tenths in -3600..=3600 {
            let degrees = f64::from(tenths) / 10.0;
            assert_eq!(yaw(parse(&format!("1,2,{degrees}")).unwrap()), degrees);
        }
    }

    #[test]
    fn a_pose_is_level() {
        let upright = Pose { x: 1.0, y: 2.0, heading: PI / 2.0, upside_down: false };
        let turned_over = Pose { upside_down: true, ..upright };
        for (text, pose) in [
            ("1,2,90", upright),
            ("1,2,90,0,0", upright),
            ("1,2,90,upside-down", turned_over),
            ("1, 2, 90, 0, 180", turned_over),
            ("1,2,90,0,-180", turned_over),
        ] {
            assert_eq!(parse(text), Ok(pose), "{text}");
        }
        for text in ["1,2,90,180,0", "1,2,90,0,90", "1,2,90,180", "1,2,90,down", "1,2,upside-down"]
        {
            let refused = parse(text).unwrap_err();
            assert!(refused.contains("`,upside-down` after it"), "{refused}");
        }
    }
}
