//! [`Values`]: the values of a reply, in as few bits as its protocol needs.

use std::fmt;
use std::iter::repeat;
use std::slice;
use std::sync::Arc;

use crate::protocol::Geometry;

/// Values of a reply. Scans of several windows may share them.
#[derive(Debug, Clone)]
pub(crate) enum Values {
    /// SCIP 1.1: 12 bits.
    Short(Arc<[u16]>),
    /// SCIP 2: 18 bits.
    Long(Arc<[u32]>),
    /// As many intensities after them, of 18 bits, too.
    WithIntensities(Arc<[u32]>),
}

impl Values {
    /// Returns `count` values from `first` on, or none if there are fewer.
    pub(super) fn part(&self, first: usize, count: usize) -> Part<'_> {
        match self {
            Self::Short(all) => Part::Short(all.get(first..first + count).unwrap_or_default()),
            Self::Long(all) | Self::WithIntensities(all) => {
                Part::Long(all.get(first..first + count).unwrap_or_default())
            }
        }
    }

    /// Returns the intensities of the same points, if there are any.
    pub(super) fn intensities(&self, first: usize, count: usize) -> Option<&[u32]> {
        match self {
            Self::WithIntensities(all) => all.get(all.len() / 2 + first..)?.get(..count),
            Self::Short(_) | Self::Long(_) => None,
        }
    }

    /// Groups `count` values from `first` on into clusters, as a sensor of SCIP 2 does: each has its
    /// least distance, or its least value if it has none.
    pub(crate) fn clustered(
        &self,
        first: usize,
        count: usize,
        cluster_count: usize,
        geometry: &Geometry,
    ) -> Self {
        let rank = |value: u32| (geometry.measurement(value).distance().is_none(), value);
        let intensities = self.intensities(first, count);
        let strengths = intensities.unwrap_or_default().iter().copied().chain(repeat(0));
        let pairs: Vec<(u32, u32)> = self.part(first, count).iter().zip(strengths).collect();
        let nearest = pairs
            .chunks(cluster_count.max(1))
            .filter_map(|cluster| cluster.iter().copied().min_by_key(|(value, _)| rank(*value)));
        let (mut values, strengths): (Vec<u32>, Vec<u32>) = nearest.unzip();
        if intensities.is_none() {
            return Self::Long(values.into());
        }
        values.extend(strengths);
        Self::WithIntensities(values.into())
    }
}

/// Some of the [`Values`] of a reply. Equal numbers are equal, however they are stored.
#[derive(Clone, Copy)]
pub(crate) enum Part<'a> {
    Short(&'a [u16]),
    Long(&'a [u32]),
}

impl<'a> Part<'a> {
    pub(super) fn iter(self) -> PartIter<'a> {
        match self {
            Self::Short(values) => PartIter::Short(values.iter()),
            Self::Long(values) => PartIter::Long(values.iter()),
        }
    }
}

impl PartialEq for Part<'_> {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Short(one), Self::Short(other)) => one == other,
            _ => self.is_equal_to(other),
        }
    }
}

impl Part<'_> {
    #[cold]
    fn is_equal_to(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Long(one), Self::Long(other)) => one == other,
            _ => self.iter().eq(other.iter()),
        }
    }
}

impl fmt::Debug for Part<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Part<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

/// Iterator over the values of a [`Part`].
#[derive(Clone)]
pub(super) enum PartIter<'a> {
    Short(slice::Iter<'a, u16>),
    Long(slice::Iter<'a, u32>),
}

impl Iterator for PartIter<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        match self {
            Self::Short(values) => values.next().map(|value| u32::from(*value)),
            Self::Long(values) => values.next().copied(),
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        match self {
            Self::Short(values) => values.size_hint(),
            Self::Long(values) => values.size_hint(),
        }
    }

    /// Chooses between the two once, not for each value.
    fn fold<B, F: FnMut(B, u32) -> B>(self, init: B, mut f: F) -> B {
        match self {
            Self::Short(values) => values.fold(init, |sum, value| f(sum, u32::from(*value))),
            Self::Long(values) => values.fold(init, |sum, value| f(sum, *value)),
        }
    }
}

impl ExactSizeIterator for PartIter<'_> {}
