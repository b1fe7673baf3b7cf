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
