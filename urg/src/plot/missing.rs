//! Reasons why a direction has no distance, in three kinds that a reader can distinguish on
//! a plot. Terminal, SVG and web page use the same words and colours for them.

use tokio_scip::Measurement;

use super::colours::Colours;

/// Kind of missing distance: blue for far, amber for weak, grey for the rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum MissingKind {
    /// Possibly an object beyond the range.
    Far,
    /// Too little light came back.
    Weak,
    Nothing,
}

impl MissingKind {
    pub(crate) const ALL: [Self; 3] = [Self::Far, Self::Weak, Self::Nothing];

    /// Classifies a measurement. Returns `None` for a distance.
    pub(crate) fn from_measurement(measurement: Measurement) -> Option<Self> {
        match measurement {
            Measurement::Distance(_) => None,
            _ if measurement.range().is_infinite() => Some(Self::Far),
            Measurement::Error(code) if code.is_low_intensity() => Some(Self::Weak),
            _ => Some(Self::Nothing),
        }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Far => "far",
            Self::Weak => "weak",
            Self::Nothing => "none",
        }
    }

    pub(crate) const fn colours(self) -> Colours {
        let (on_light, on_dark, indexed) = match self {
            Self::Far => ("#1f5fc4", "#6ea8ff", 69),
            Self::Weak => ("#9a6200", "#e8b34b", 178),
            Self::Nothing => ("#72808c", "#8a97a3", 245),
        };
        Colours { on_light, on_dark, indexed }
    }

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
    fn every_value_is_a_distance_or_of_one_kind() {
        let geometry = tokio_scip::Geometry::URG_04LX;
        let kind = |value| MissingKind::from_measurement(geometry.measurement(value));
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
