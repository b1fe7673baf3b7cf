//! One revolution: from the echo of each beam to the value that a sensor sends.

use super::surface::{Echo, Vector};
use super::{Values, WorldTime};
use crate::random::{fraction, mix};

/// Steps that a sensor measures.
pub(super) const WINDOW: std::ops::RangeInclusive<usize> = 44..=725;

/// Cosine and sine of one step, 1/1024 of a full angle.
const STEP: Vector = (0.999_981_175_282_601_1, 0.006_135_884_649_154_475);

/// Errors of measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Noise {
    /// Errors like a real sensor's, drawn from this seed: each distance is off by some
    /// millimetres, and some points are missing.
    Seeded(u64),
    /// No errors: each distance is exact, rounded to a millimetre.
    None,
}

/// Measures the echo of each step, in its direction, and fills in its value.
pub(super) fn sweep(
    noise: Noise,
    time: WorldTime,
    values: &mut Values,
    echo: impl Fn(usize, Vector) -> Echo,
) {
    // Step 0 is at the right rear, -135 degrees.
    let half = 0.5_f64.sqrt();
    let mut direction = (-half, -half);
    for (step, value) in values.iter_mut().enumerate() {
        if WINDOW.contains(&step) {
            let echo = echo(step, direction);
            *value = match noise {
                Noise::None => range_value(echo.distance.round()),
                Noise::Seeded(seed) => {
                    let revolution = mix(seed ^ mix(time.revolution.wrapping_add(1)));
                    noisy_value(echo, mix(revolution.wrapping_add(step as u64)))
                }
            };
        }
        direction = (
            direction.0 * STEP.0 - direction.1 * STEP.1,
            direction.1 * STEP.0 + direction.0 * STEP.1,
        );
    }
    if noise != Noise::None {
        hide_lone_points(values);
    }
}

fn noisy_value(Echo { distance, light }: Echo, noise: u64) -> u32 {
    let spread = fraction(noise) + fraction(mix(noise)) - 1.0;
    let measured = distance + spread * (4.0 + 0.004 * distance);
    let metres = distance / 1000.0;
    let is_dark = (20.0..=4_094.0).contains(&measured) && light < 0.004 * metres * metres;
    match () {
        () if noise.is_multiple_of(300) => 9,
        () if is_dark => 1 + (noise % 5) as u32,
        () => range_value(measured),
    }
}

/// Converts a distance to a value: millimetres, or the error code of its range.
fn range_value(distance: f64) -> u32 {
    match distance {
        d if d < 20.0 => 8,
        d if d > 12_000.0 => 0,
        d if d > 5_600.0 => 6,
        d if d > 4_094.0 => 16,
        d => d as u32,
    }
}

/// Replaces each distance between two error codes by error code 7, as the sensor does.
pub(super) fn hide_lone_points(values: &mut Values) {
    let mut before = true;
    for step in WINDOW {
        let after = values.get(step + 1).is_none_or(|&value| value < 20);
        if let Some(value) = values.get_mut(step) {
            let is_distance = *value >= 20;
            if is_distance && before && after {
                *value = 7;
            }
            before = !is_distance;
        }
    }
}
