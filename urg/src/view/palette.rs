//! Colours that the terminal supports.

use std::ffi::OsString;

use ratatui::style::{Color, Modifier, Style};

use crate::plot::colours::{self, DISTANCES, SENSORS};
use crate::plot::missing::MissingKind;

/// Distance colours for a terminal with 16 colours.
const SIXTEEN: [Color; DISTANCES.len()] = [
    Color::LightRed,
    Color::Yellow,
    Color::Yellow,
    Color::Green,
    Color::Cyan,
    Color::Cyan,
    Color::LightBlue,
    Color::Magenta,
];

const SIXTEEN_SENSORS: [Color; SENSORS.len()] =
    [Color::LightBlue, Color::Yellow, Color::Green, Color::Magenta, Color::LightRed, Color::Cyan];

/// Number of colours that a terminal supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Palette {
    Plain,
    Sixteen,
    Many,
}

impl Palette {
    /// Chooses a palette by the environment variables of the terminal and of
    /// <https://no-color.org>.
    pub(crate) fn of(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let text = |name| variable(name).unwrap_or_default().to_string_lossy().into_owned();
        let term = text("TERM");
        if !text("NO_COLOR").is_empty() || term.ends_with("-m") || term.starts_with("vt") {
            Self::Plain
        } else if term.contains("256color") || !text("COLORTERM").is_empty() {
            Self::Many
        } else {
            Self::Sixteen
        }
    }

    /// Colours from near to far.
    pub(crate) fn distances(self) -> [Color; DISTANCES.len()] {
        match self {
            Self::Plain => [Color::Reset; DISTANCES.len()],
            Self::Sixteen => SIXTEEN,
            Self::Many => DISTANCES.map(|one| Color::Indexed(one.indexed)),
        }
    }

    pub(crate) fn distance(self, metres: f64) -> Color {
        self.distances().get(colours::band(metres)).copied().unwrap_or_default()
    }

    /// Colour of a sensor among several. `number` counts from 0. Colours repeat if there are
    /// more sensors.
    pub(crate) fn sensor(self, number: usize) -> Color {
        let colours = match self {
            Self::Plain => [Color::Reset; SENSORS.len()],
            Self::Sixteen => SIXTEEN_SENSORS,
            Self::Many => SENSORS.map(|one| Color::Indexed(one.indexed)),
        };
        colours.get(number % SENSORS.len()).copied().unwrap_or_default()
    }

    pub(crate) fn missing(self, kind: MissingKind) -> Color {
        match (self, kind) {
            (Self::Plain, _) => Color::Reset,
            (Self::Sixteen, MissingKind::Far) => Color::LightBlue,
            (Self::Sixteen, MissingKind::Weak) => Color::Yellow,
            (Self::Sixteen, MissingKind::Nothing) => Color::Gray,
            (Self::Many, kind) => Color::Indexed(kind.colours().indexed),
        }
    }

    /// For rings, and for scans that are not current.
    pub(crate) fn faint(self) -> Color {
        match self {
            Self::Plain => Color::Reset,
            _ => Color::DarkGray,
        }
    }

    /// For labels.
    pub(crate) fn quiet() -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }

    pub(crate) fn good(self) -> Style {
        self.strong(Color::Green)
    }

    pub(crate) fn poor(self) -> Style {
        self.strong(Color::Yellow)
    }

    pub(crate) fn bad(self) -> Style {
        self.strong(Color::Red)
    }

    fn strong(self, color: Color) -> Style {
        match self {
            Self::Plain => Style::new().add_modifier(Modifier::BOLD),
            _ => Style::new().fg(color),
        }
    }

    /// For a line that must stand out.
    pub(crate) fn bar() -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn palette(variables: &[(&str, &str)]) -> Palette {
        Palette::of(|name| {
            variables.iter().find(|(other, _)| *other == name).map(|(_, value)| value.into())
        })
    }

    #[test]
    fn the_terminal_and_the_user_decide_on_colours() {
        assert_eq!(palette(&[("TERM", "xterm-256color")]), Palette::Many);
        assert_eq!(palette(&[("TERM", "xterm"), ("COLORTERM", "truecolor")]), Palette::Many);
        assert_eq!(palette(&[("TERM", "linux")]), Palette::Sixteen);
        assert_eq!(palette(&[("TERM", "xterm-256color"), ("NO_COLOR", "")]), Palette::Many);
        assert_eq!(palette(&[("TERM", "xterm-256color"), ("NO_COLOR", "1")]), Palette::Plain);
        assert_eq!(palette(&[("TERM", "vt100")]), Palette::Plain);
    }

    #[test]
    fn every_distance_has_a_colour_and_near_ones_differ_from_far_ones() {
        for palette in [Palette::Sixteen, Palette::Many] {
            assert_ne!(palette.distance(0.02), palette.distance(4.0));
            assert_eq!(palette.distance(4.094), palette.distances()[7]);
            assert_eq!(palette.distance(99.0), palette.distances()[7]);
        }
        assert_eq!(Palette::Plain.distance(0.1), Color::Reset);
    }

    #[test]
    fn a_seventh_sensor_has_the_colour_of_the_first() {
        for palette in [Palette::Sixteen, Palette::Many] {
            assert_eq!(
                [6, 11].map(|number| palette.sensor(number)),
                [0, 5].map(|number| palette.sensor(number))
            );
            assert_ne!(palette.sensor(0), palette.sensor(5));
        }
    }
}
