//! The reasons why a direction has no distance, in the three kinds that eyes can
//! distinguish on a plot. Terminal, SVG and page use the same words, marks and
//! colours for them.

use tokio_scip::Measurement;

/// A reason for a missing distance. Far is blue, weak amber and none grey,
/// everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum MissingKind {
    /// Possibly an object beyond the range.
    Far,
    /// Too little light came back.
    Weak,
    /// Anything else.
    Nothing,
}

/// The colours of a kind, one hue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct KindColours {
    /// For paper and light pages.
    pub(crate) on_light: &'static str,
    pub(crate) on_dark: &'static str,
    /// Of a terminal's 256.
    pub(crate) indexed: u8,
}

impl MissingKind {
    pub(crate) const ALL: [Self; 3] = [Self::Far, Self::Weak, Self::Nothing];

    /// Returns the kind of `measurement`; `None` for a distance.
    pub(crate) fn of(measurement: Measurement) -> Option<Self> {
        match measurement {
            Measurement::Distance(_) => None,
            Measurement::Saturated => Some(Self::Far),
            Measurement::Error(code) if code.is_beyond_range() => Some(Self::Far),
            Measurement::Error(code) if code.is_low_intensity() => Some(Self::Weak),
            Measurement::Error(_) => Some(Self::Nothing),
        }
    }

    /// Returns one word for it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Far => "far",
            Self::Weak => "weak",
            Self::Nothing => "none",
        }
    }

    /// Returns its colours.
    pub(crate) const fn colours(self) -> KindColours {
        let (on_light, on_dark, indexed) = match self {
            Self::Far => ("#1f5fc4", "#6ea8ff", 69),
            Self::Weak => ("#9a6200", "#e8b34b", 178),
            Self::Nothing => ("#72808c", "#8a97a3", 245),
        };
        KindColours { on_light, on_dark, indexed }
    }

    /// Returns a few words for it.
    pub(crate) const fn meaning(self) -> &'static str {
        match self {
            Self::Far => "possibly beyond the range",
            Self::Weak => "too little light came back",
            Self::Nothing => "no distance for other reasons",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_terminal_s_colours_are_those_of_the_page_as_near_as_it_has_them() {
        for kind in MissingKind::ALL {
            let KindColours { on_dark, indexed, .. } = kind.colours();
            let page = |at: usize| i32::from_str_radix(&on_dark[at..at + 2], 16).unwrap();
            let levels = [0, 95, 135, 175, 215, 255];
            let terminal = match usize::from(indexed) {
                grey @ 232.. => [8 + 10 * (grey as i32 - 232); 3],
                cube => [(cube - 16) / 36, (cube - 16) / 6 % 6, (cube - 16) % 6].map(|n| levels[n]),
            };
            for (page, terminal) in [page(1), page(3), page(5)].into_iter().zip(terminal) {
                assert!((page - terminal).abs() <= 80, "{kind:?}: {page} and {terminal}");
            }
        }
    }

    #[test]
    fn every_value_is_a_distance_or_of_one_kind() {
        let kind = |value| MissingKind::of(Measurement::from_value(value));
        for value in 0..=4095 {
            let expected = match value {
                0 | 6 | 16 | 4095 => Some(MissingKind::Far),
                1..=5 => Some(MissingKind::Weak),
                7..=19 => Some(MissingKind::Nothing),
                _ => None,
            };
            assert_eq!(kind(value), expected, "{value}");
        }
    }
}
