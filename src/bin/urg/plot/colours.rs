//! The colours of things that the page, a picture on paper and a terminal all show:
//! one hue for a thing, in the shade that its medium needs.

/// The shades of a colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Colours {
    /// For paper and light pages.
    pub(crate) on_light: &'static str,
    pub(crate) on_dark: &'static str,
    /// Of a terminal's 256.
    pub(crate) indexed: u8,
}

/// The colours of sensors in one picture, in their order.
pub(crate) const SENSORS: [Colours; 6] = [
    Colours { on_light: "#0068ad", on_dark: "#6cc5ff", indexed: 74 },
    Colours { on_light: "#a85400", on_dark: "#ffb057", indexed: 208 },
    Colours { on_light: "#1c7a2d", on_dark: "#7fdc8b", indexed: 71 },
    Colours { on_light: "#7a3fb0", on_dark: "#d9a5ff", indexed: 134 },
    Colours { on_light: "#b3255a", on_dark: "#ff8fb0", indexed: 204 },
    Colours { on_light: "#6b6600", on_dark: "#e0db6c", indexed: 143 },
];

/// Returns the item for the sensor of this number, counted from 0. They repeat if there
/// are more sensors than items.
pub(crate) fn of_sensor<T: Copy + Default>(items: [T; SENSORS.len()], number: usize) -> T {
    items.get(number % SENSORS.len()).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::missing::MissingKind;
    use super::*;

    #[test]
    fn the_terminal_s_colours_are_those_of_the_page_as_near_as_it_has_them() {
        let kinds = MissingKind::ALL.map(MissingKind::colours);
        for colours in SENSORS.into_iter().chain(kinds) {
            let page = |at: usize| i32::from_str_radix(&colours.on_dark[at..at + 2], 16).unwrap();
            let levels = [0, 95, 135, 175, 215, 255];
            let terminal = match usize::from(colours.indexed) {
                grey @ 232.. => [8 + 10 * (grey as i32 - 232); 3],
                cube => [(cube - 16) / 36, (cube - 16) / 6 % 6, (cube - 16) % 6].map(|n| levels[n]),
            };
            for (page, terminal) in [page(1), page(3), page(5)].into_iter().zip(terminal) {
                assert!((page - terminal).abs() <= 90, "{colours:?}: {page} and {terminal}");
            }
        }
    }

    #[test]
    fn a_seventh_sensor_has_the_colour_of_the_first() {
        assert_eq!(of_sensor([1, 2, 3, 4, 5, 6], 6), 1);
        assert_eq!(of_sensor([1, 2, 3, 4, 5, 6], 11), 6);
    }
}
