//! Random numbers that are the same on every machine and in every version.

/// Splitmix64 generator (Steele, Lea and Flood, 2014): one word of state, any seed is
/// good, and the function below is its whole definition.
#[derive(Debug, Clone)]
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.0)
    }

    /// Draws a number in `0..bound`, or 0 if `bound` is 0.
    pub(super) fn below(&mut self, bound: u64) -> u64 {
        // High word of the product. Its bias of bound / 2^64 does not matter here.
        ((u128::from(self.next()) * u128::from(bound)) >> 64) as u64
    }

    /// Draws a number in `0.0..1.0`.
    pub(super) fn fraction(&mut self) -> f64 {
        fraction(self.next())
    }
}

/// Hashes a number with splitmix64's output function: every bit of the input changes
/// every bit of the output. For noise that depends on a step and a revolution but not on
/// earlier draws.
pub(super) fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Converts 53 bits of a random word to a number in `0.0..1.0`.
pub(super) fn fraction(word: u64) -> f64 {
    (word >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_published_generator_and_stay_below_their_bound() {
        let mut random = Random::new(1_234_567);
        let drawn: Vec<u64> = (0..3).map(|_| random.next()).collect();
        assert_eq!(
            drawn,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
        assert!((0..1000).all(|_| random.below(7) < 7));
        assert_eq!(random.below(0), 0);
        assert!((0..1000).all(|_| (0.0..1.0).contains(&random.fraction())));
    }
}
