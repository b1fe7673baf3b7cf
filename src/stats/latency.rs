//! [`LatencyStats`]: distribution of reply times, in a histogram of fixed size.

use std::fmt;
use std::time::Duration;

/// Number of buckets for each doubling of the time, so a bucket is at most an eighth wide.
const PER_OCTAVE: u64 = 8;
/// Width of the narrowest buckets in microseconds.
const UNIT_MICROS: u64 = 64;
/// Reaches 16.8 s, longer than the longest deadline.
const BUCKETS: usize = 128;

/// Times from a `G` to the last byte of its reply. All zero before the first reply. In a stream of
/// SCIP 2, where the sensor sends scans unasked, times from one scan to the next: for the age of a scan
/// use [`Scan::times`](crate::Scan::times).
///
/// As data (feature `serde`) it is `count`, and in seconds `last`, `min`, `max`,
/// `total`, and the quantiles `p50`, `p90` and `p99`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct LatencyStats {
    /// Latest time.
    pub last: Duration,
    /// Shortest time.
    pub min: Duration,
    /// Longest time.
    pub max: Duration,
    /// Sum of all times.
    pub total: Duration,
    /// Number of replies.
    pub count: u64,
    histogram: Histogram,
}

impl LatencyStats {
    /// Time within which the fraction `q` of the replies arrived: pass 0.5 for the median, or 0.99 for
    /// the time that one reply in a hundred exceeds. Zero before the first reply. Clamps `q` to 0..=1.
    ///
    /// Never shorter than the exact quantile, and longer by at most an eighth or 64 us,
    /// whichever is more. Above 15.7 s it is [`max`](Self::max).
    pub fn quantile(&self, q: f64) -> Duration {
        let rank = (q.clamp(0.0, 1.0) * self.count as f64).ceil() as u64;
        let mut counted = 0;
        let bucket = self.histogram.0.iter().position(|count| {
            counted += count;
            counted >= rank.max(1)
        });
        let bound = bucket.filter(|bucket| bucket + 1 < BUCKETS).map_or(self.max, upper_bound);
        bound.clamp(self.min, self.max)
    }

    pub(crate) fn add(&mut self, latency: Duration) {
        self.last = latency;
        self.min = if self.count == 0 { latency } else { self.min.min(latency) };
        self.max = self.max.max(latency);
        self.total += latency;
        self.count += 1;
        if let Some(count) = self.histogram.0.get_mut(bucket_of(latency)) {
            *count += 1;
        }
    }
}

/// Number of replies in each bucket.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Histogram([u64; BUCKETS]);

impl Default for Histogram {
    fn default() -> Self {
        Self([0; BUCKETS])
    }
}

impl fmt::Debug for Histogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("..")
    }
}

/// Finds the bucket of a time: one unit wide up to 16 units, then eight for each doubling.
fn bucket_of(latency: Duration) -> usize {
    let seconds = latency.as_secs().saturating_mul(1_000_000);
    let units = seconds.saturating_add(latency.subsec_micros().into()) / UNIT_MICROS;
    let octave = (units | PER_OCTAVE).ilog2() - PER_OCTAVE.ilog2();
    let bucket = u64::from(octave) * PER_OCTAVE + (units >> octave);
    usize::try_from(bucket).map_or(BUCKETS - 1, |bucket| bucket.min(BUCKETS - 1))
}

/// Shortest time above all times of a bucket.
fn upper_bound(bucket: usize) -> Duration {
    let next = bucket as u64 + 1;
    let octave = (next / PER_OCTAVE).saturating_sub(1);
    Duration::from_micros(((next - octave * PER_OCTAVE) << octave) * UNIT_MICROS)
}

#[cfg(feature = "serde")]
impl serde::Serialize for LatencyStats {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;

        let mut stats = serializer.serialize_struct("LatencyStats", 8)?;
        stats.serialize_field("last", &self.last.as_secs_f64())?;
        stats.serialize_field("min", &self.min.as_secs_f64())?;
        stats.serialize_field("max", &self.max.as_secs_f64())?;
        stats.serialize_field("total", &self.total.as_secs_f64())?;
        stats.serialize_field("count", &self.count)?;
        stats.serialize_field("p50", &self.quantile(0.5).as_secs_f64())?;
        stats.serialize_field("p90", &self.quantile(0.9).as_secs_f64())?;
        stats.serialize_field("p99", &self.quantile(0.99).as_secs_f64())?;
        stats.end()
    }
}
