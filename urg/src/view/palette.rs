//! Colours that the terminal supports.

use std::ffi::OsString;

use ratatui::style::{Color, Modifier, Style};

use crate::plot::colours::{self, DISTANCES, INTENSITIES, SENSORS, WEAK_SENSORS};
use crate::plot::missing::MissingKind;

/// Whether a terminal supports colours. Terminals without 256 colours show the nearest of theirs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Palette {
    Plain,
    Coloured,
}

impl Palette {
    /// Chooses a palette by the environment variables of the terminal and of <https://no-color.org>.
    pub(crate) fn from_environment(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let text = |name| variable(name).unwrap_or_default().to_string_lossy().into_owned();
        let term = text("TERM");
        if !text("NO_COLOR").is_empty() || term.ends_with("-m") || term.starts_with("vt") {
            Self::Plain
        } else {
            Self::Coloured
        }
    }

    /// Colour of this index, or the default without colours.
    fn indexed(self, index: u8) -> Color {
        match self {
            Self::Plain => Color::Reset,
            Self::Coloured => Color::Indexed(index),
        }
    }

    /// Colours from near to far.
    pub(crate) fn distances(self) -> [Color; DISTANCES.len()] {
        DISTANCES.map(|one| self.indexed(one.indexed))
    }

    /// Colour of a distance, for bands of this width.
    pub(crate) fn distance(self, metres: f64, width: f64) -> Color {
        self.distances().get(colours::band(metres, width)).copied().unwrap_or_default()
    }

    /// Shades of intensities, from weak to strong.
    pub(crate) fn intensities(self) -> [Color; INTENSITIES.len()] {
        INTENSITIES.map(|one| self.indexed(one.indexed))
    }

    /// Colour of a shade.
    pub(crate) fn intensity(self, shade: usize) -> Color {
        self.intensities().get(shade).copied().unwrap_or_default()
    }

    /// Colour of a point of a sensor among several: darker for the weaker half of the shades.
    pub(crate) fn sensor_point(self, number: usize, shade: Option<usize>) -> Color {
        match WEAK_SENSORS.get(number % WEAK_SENSORS.len()) {
            Some(weak) if shade.is_some_and(|n| n < INTENSITIES.len() / 2) => self.indexed(*weak),
            _ => self.sensor(number),
        }
    }

    /// Colour of a sensor among several. `number` counts from 0. Many sensors share colours.
    pub(crate) fn sensor(self, number: usize) -> Color {
        let colours = SENSORS.map(|one| self.indexed(one.indexed));
        colours.get(number % SENSORS.len()).copied().unwrap_or_default()
    }

    pub(crate) fn missing(self, kind: MissingKind) -> Color {
        self.indexed(kind.colours().indexed)
    }

    /// For rings, and for scans that are not current.
    pub(crate) fn faint(self) -> Color {
        match self {
            Self::Plain => Color::Reset,
            Self::Coloured => Color::DarkGray,
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
        Palette::from_environment(|name| {
            variables.iter().find(|(other, _)| *other == name).map(|(_, value)| value.into())
        })
    }

    #[test]
    fn the_terminal_and_the_user_decide_on_colours() {
        assert_eq!(palette(&[("TERM", "xterm-256color")]), Palette::Coloured);
        assert_eq!(palette(&[("TERM", "linux"), ("NO_COLOR", "")]), Palette::Coloured);
        assert_eq!(palette(&[("TERM", "xterm-256color"), ("NO_COLOR", "1")]), Palette::Plain);
        assert_eq!(palette(&[("TERM", "vt100")]), Palette::Plain);
    }

    #[test]
    fn colours_repeat_after_the_last_sensor() {
        let colour = |number| Palette::Coloured.sensor(number);
        assert_eq!([6, 11].map(colour), [0, 5].map(colour));
        assert_ne!(colour(0), colour(5));
    }
}
