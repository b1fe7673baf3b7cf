//! Colours that the web page, the terminal and the SVG picture share. Each thing has one
//! hue, in a shade for each medium.

/// Shades of one colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Colours {
    /// For paper and light pages.
    pub(crate) on_light: &'static str,
    pub(crate) on_dark: &'static str,
    /// Index into a terminal's 256 colours.
    pub(crate) indexed: u8,
}

/// Colours of the sensors in one picture, in order.
pub(crate) const SENSORS: [Colours; 6] = [
    Colours { on_light: "#0068ad", on_dark: "#6cc5ff", indexed: 74 },
    Colours { on_light: "#a85400", on_dark: "#ffb057", indexed: 208 },
    Colours { on_light: "#1c7a2d", on_dark: "#7fdc8b", indexed: 71 },
    Colours { on_light: "#7a3fb0", on_dark: "#d9a5ff", indexed: 134 },
    Colours { on_light: "#b3255a", on_dark: "#ff8fb0", indexed: 204 },
    Colours { on_light: "#6b6600", on_dark: "#e0db6c", indexed: 143 },
];

/// Widths in metres of the bands that share one colour of [`DISTANCES`], for pictures of any size.
pub(crate) const WIDTHS: [f64; 9] = [0.5, 1.0, 1.5, 2.0, 2.5, 4.0, 5.0, 8.0, 16.0];
/// Part of a picture's radius that the bands cover at least.
pub(crate) const COVERED: f64 = 0.9;

/// Colours of distances, near to far: orange, yellow, green, blue, violet. The last colour
/// also covers everything farther away.
pub(crate) const DISTANCES: [Colours; 8] = [
    Colours { on_light: "#aa5900", on_dark: "#f8aa66", indexed: 208 },
    Colours { on_light: "#8f6d00", on_dark: "#dbbb56", indexed: 178 },
    Colours { on_light: "#627e00", on_dark: "#aecb6d", indexed: 106 },
    Colours { on_light: "#00884a", on_dark: "#77d599", indexed: 35 },
    Colours { on_light: "#008a7d", on_dark: "#42d8c9", indexed: 37 },
    Colours { on_light: "#0083a6", on_dark: "#45d1f2", indexed: 38 },
    Colours { on_light: "#1675be", on_dark: "#79c4ff", indexed: 33 },
    Colours { on_light: "#6265c1", on_dark: "#adb5ff", indexed: 105 },
];

/// Shades of intensities, weak to strong: violet, red, orange, in rising contrast with the ground,
/// so that they differ even in grey. A terminal's ground is unknown: there they only get lighter.
pub(crate) const INTENSITIES: [Colours; DISTANCES.len()] = [
    Colours { on_light: "#9087f6", on_dark: "#6b5dcf", indexed: 61 },
    Colours { on_light: "#a16dd7", on_dark: "#9961d1", indexed: 97 },
    Colours { on_light: "#af54a9", on_dark: "#c965c2", indexed: 133 },
    Colours { on_light: "#b23e74", on_dark: "#f06ea6", indexed: 169 },
    Colours { on_light: "#ab2e3a", on_dark: "#ff8a8c", indexed: 204 },
    Colours { on_light: "#8d3802", on_dark: "#ffab85", indexed: 209 },
    Colours { on_light: "#6a3d02", on_dark: "#ffc791", indexed: 179 },
    Colours { on_light: "#4f3900", on_dark: "#fee1a4", indexed: 214 },
];
/// Colours of the weaker half of intensities for each of [`SENSORS`], in a terminal.
pub(crate) const WEAK_SENSORS: [u8; SENSORS.len()] = [31, 166, 28, 92, 161, 100];

/// Binary logarithm of the intensity where the shades begin.
///
/// Intensities have 18 bits, and Hokuyo documents neither unit nor range. The filters of ROS call
/// those below 100 dark, and start with bright ones at 8,000; scans of UST-10LX have 370 to 1,913.
/// So each shade doubles the last.
/// A scale that followed the scan would change the shade of a wall with each reflector in sight.
pub(crate) const WEAKEST: u32 = 6;

/// Index of an intensity's colour in [`INTENSITIES`].
pub(crate) fn shade(intensity: u32) -> usize {
    (intensity.max(1).ilog2().saturating_sub(WEAKEST) as usize).min(INTENSITIES.len() - 1)
}

/// Intensities at the ends of the shades' scale.
pub(crate) const SCALE: [u32; 2] = [1 << WEAKEST, 1 << (WEAKEST + INTENSITIES.len() as u32)];

/// Width of a band in a picture of this radius: half a metre for a URG-04LX.
pub(crate) fn width(reach: f64) -> f64 {
    let covers = |width: &f64| width * DISTANCES.len() as f64 >= COVERED * reach;
    let [.., widest] = WIDTHS;
    WIDTHS.into_iter().find(covers).unwrap_or(widest)
}

/// Index of a distance's colour in [`DISTANCES`], for bands of this width.
pub(crate) fn band(metres: f64, width: f64) -> usize {
    // A cast from float to integer saturates.
    ((metres / width) as usize).min(DISTANCES.len() - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_half_metre_has_a_colour() {
        let band = |metres| band(metres, width(4.2));
        assert_eq!([0.0, 0.49, 0.5, 3.99, 4.0, 99.0].map(band), [0, 0, 1, 7, 7, 7]);
    }

    #[test]
    fn each_shade_doubles_the_intensity() {
        let most = (1 << 18) - 1;
        assert_eq!([0, 1, 64, 127, 128, 255].map(shade), [0, 0, 0, 0, 1, 1]);
        assert_eq!([1024, 8191, 8192, 16_384, most].map(shade), [4, 6, 7, 7, 7]);
        assert_eq!(SCALE, [64, 16_384]);
    }

    /// Contrast with white, as WCAG defines it, of a colour such as `#9087f6`.
    fn contrast(colour: &str) -> f64 {
        let linear = |part: u32| match f64::from(part) / 255.0 {
            dark if dark <= 0.040_45 => dark / 12.92,
            part => ((part + 0.055) / 1.055).powf(2.4),
        };
        let rgb = u32::from_str_radix(&colour[1..], 16).unwrap();
        let [red, green, blue] = [16, 8, 0].map(|bits| linear(rgb >> bits & 255));
        1.05 / (0.2126 * red + 0.7152 * green + 0.0722 * blue + 0.05)
    }

    /// Contrast with white of a colour of the 256-colour cube.
    fn indexed(index: u8) -> f64 {
        let level = |part| [0, 95, 135, 175, 215, 255][usize::from(index - 16) / part % 6];
        contrast(&format!("#{:02x}{:02x}{:02x}", level(36), level(6), level(1)))
    }

    #[test]
    fn shades_differ_without_hue() {
        let grounds = [contrast("#ffffff"), contrast("#131b22")];
        for pair in INTENSITIES.windows(2) {
            let [weak, strong] = pair else { unreachable!() };
            assert!(contrast(strong.on_light) > 1.1 * contrast(weak.on_light), "{strong:?}");
            assert!(1.1 * contrast(strong.on_dark) < contrast(weak.on_dark), "{strong:?}");
            assert!(indexed(strong.indexed) < indexed(weak.indexed), "{strong:?}");
        }
        // Readable on the ground, and in a terminal on black and on white.
        assert!(contrast(INTENSITIES[0].on_light) / grounds[0] > 3.0);
        assert!(grounds[1] / contrast(INTENSITIES[0].on_dark) > 3.0);
        for index in INTENSITIES.map(|one| one.indexed).into_iter().chain(WEAK_SENSORS) {
            assert!((1.8..7.0).contains(&indexed(index)), "{index}: {}", indexed(index));
        }
    }

    #[test]
    fn the_colours_cover_each_picture() {
        for (reach, expected) in [
            (4.2, 0.5),
            (5.8, 1.0),
            (10.0, 1.5),
            (20.0, 2.5),
            (30.0, 4.0),
            (61.2, 8.0),
            (1e3, 16.0),
        ] {
            assert_eq!(width(reach), expected, "{reach}");
        }
    }
}
