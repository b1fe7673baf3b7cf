//! One revolution: from the echo of each beam to the value that a sensor sends.

use super::surface::{Echo, Vector};
use super::{Values, WorldTime};
use crate::models::Geometry;
use crate::random::{fraction, mix};

/// Measures the echo of each step, in its direction, and fills in its value. Draws errors like a
/// real sensor's from the seed `noise`: each distance is off by some millimetres, and some points
/// are missing. `None` rounds each distance to a millimetre.
pub(super) fn sweep(
    noise: Option<u64>,
    time: WorldTime,
    values: &mut Values,
    echo: impl Fn(usize, Vector) -> Echo,
) {
    let geometry = time.geometry;
    let (window, turn) = (geometry.window(), geometry.step());
    // Step 0 of every model is at the right rear, -135 degrees.
    let half = 0.5_f64.sqrt();
    let mut direction = (-half, -half);
    for (step, value) in values.iter_mut().enumerate() {
        if window.contains(&step) {
            let echo = echo(step, direction);
            *value = match noise {
                None => geometry.value(echo.distance.round()),
                Some(seed) => {
                    let revolution = mix(seed ^ mix(time.revolution.wrapping_add(1)));
                    noisy_value(&geometry, echo, mix(revolution.wrapping_add(step as u64)))
                }
            };
        }
        direction = (
            direction.0 * turn.0 - direction.1 * turn.1,
            direction.1 * turn.0 + direction.0 * turn.1,
        );
    }
    if noise.is_some() {
        hide_lone_points(&geometry, values);
    }
}

fn noisy_value(geometry: &Geometry, Echo { distance, light }: Echo, noise: u64) -> u32 {
    let spread = fraction(noise) + fraction(mix(noise)) - 1.0;
    let measured = distance + spread * (4.0 + 0.004 * distance);
    let range = f64::from(geometry.nearest)..=f64::from(geometry.farthest);
    let dark = range.contains(&measured).then(|| geometry.dark(distance, light, noise)).flatten();
    match dark {
        _ if noise.is_multiple_of(300) => geometry.codes.unstable,
        Some(code) => code,
        None => geometry.value(measured),
    }
}

/// Replaces each distance between two that are missing by a code, as the sensor does.
fn hide_lone_points(geometry: &Geometry, values: &mut Values) {
    let mut before = true;
    for step in geometry.window() {
        let after = values.get(step + 1).is_none_or(|&value| !geometry.is_distance(value));
        if let Some(value) = values.get_mut(step) {
            let is_distance = geometry.is_distance(*value);
            if is_distance && before && after {
                *value = geometry.codes.flickering;
            }
            before = !is_distance;
        }
    }
}
