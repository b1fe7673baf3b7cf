//! Why a direction has no distance, in the few kinds that eyes can tell apart
//! on a plot.

use std::collections::BTreeMap;

use tokio_scip::{Measurement, Scan};

/// A kind of error code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum MissingKind {
    /// Possibly an object beyond the range.
    Far,
    /// Too little light came back.
    Weak,
    /// Anything else.
    Nothing,
}

impl MissingKind {
    pub(crate) const ALL: [Self; 3] = [Self::Far, Self::Weak, Self::Nothing];

    /// Why `measurement` is no distance, if it is none.
    pub(crate) fn of(measurement: Measurement) -> Option<Self> {
        match measurement {
            Measurement::Distance(_) => None,
            Measurement::Saturated => Some(Self::Far),
            Measurement::Error(code) if code.is_beyond_range() => Some(Self::Far),
            Measurement::Error(code) if code.is_low_intensity() => Some(Self::Weak),
            Measurement::Error(_) => Some(Self::Nothing),
        }
    }

    /// In one word.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Far => "far",
            Self::Weak => "weak",
            Self::Nothing => "none",
        }
    }

    /// In a few words.
    pub(crate) const fn meaning(self) -> &'static str {
        match self {
            Self::Far => "possibly beyond the range",
            Self::Weak => "too little light came back",
            Self::Nothing => "no distance for other reasons",
        }
    }
}

/// How many directions of a scan have a distance, and why others have none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct DistanceCount {
    pub(crate) distances: usize,
    /// How often each value came that is no distance.
    values: BTreeMap<u16, usize>,
}

impl DistanceCount {
    pub(crate) fn of(scan: &Scan) -> Self {
        let mut count = Self::default();
        for measurement in scan.measurements() {
            if measurement.distance().is_some() {
                count.distances += 1;
            } else {
                *count.values.entry(measurement.value()).or_default() += 1;
            }
        }
        count
    }

    /// The values of one kind, each with how often it came.
    pub(crate) fn values(&self, kind: MissingKind) -> impl Iterator<Item = (u16, usize)> {
        let of = move |value: u16| MissingKind::of(Measurement::from_value(value));
        self.values
            .iter()
            .filter(move |(value, _)| of(**value) == Some(kind))
            .map(|(value, count)| (*value, *count))
    }

    /// How many directions have none for this reason.
    pub(crate) fn count(&self, kind: MissingKind) -> usize {
        self.values(kind).map(|(_, count)| count).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
