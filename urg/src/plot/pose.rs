//! Poses of sensors in the common frame, as the command line and the page write them: X,Y,YAW
//! in metres and degrees.

use tokio_scip::scan::Pose;

/// Maximum distance from the origin along each axis, in metres.
pub(crate) const FARTHEST: f64 = 1000.0;

/// Parses distances and an angle in degrees. Returns them in metres and radians.
pub(crate) fn distances_and_angle<const N: usize>(text: &str) -> Option<([f64; N], f64)> {
    let (distances, yaw) = text.rsplit_once(',')?;
    let within = |text: &str, most: f64| {
        text.trim().parse().ok().filter(|number: &f64| number.abs() <= most)
    };
    let distances = distances.split(',').map(|metres| within(metres, FARTHEST));
    let distances: Vec<f64> = distances.collect::<Option<_>>()?;
    Some((distances.try_into().ok()?, within(yaw, 360.0)?.to_radians()))
}

pub(crate) fn parse(text: &str) -> Result<Pose, String> {
    match distances_and_angle(text) {
        Some(([x, y], heading)) => Ok(Pose { x, y, heading }),
        None => Err(format!(
            "invalid place `{text}`: expected X,Y,YAW in metres and degrees, such as 0.2,0,90, and \
             at most {FARTHEST} m and 360°"
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
}
