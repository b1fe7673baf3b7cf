//! Scans: decodes values, and checks the sum of each line on the way.

use std::iter::repeat_n;
use std::slice::{from_mut, from_ref};
use std::sync::Arc;
use std::time::Duration;

#[cfg(all(feature = "simd", target_feature = "sse2"))]
use safe_arch::*;

use super::command::{Data, LINE};
use super::lines::{FIRST_CHARACTER, block, number, quoted};
use crate::protocol::MalformedError;

/// Values of three characters in three full lines: no value runs over the end of these.
const VALUES: usize = 64;
/// Length of a full line with its sum and LF, and of three of them.
const FULL: usize = LINE + 2;
const BLOCK: usize = 3 * FULL;

/// Time of a sensor's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stamp {
    /// Milliseconds, 24 bits: begins anew at 0 after 4 h 40 min, and at a reset (p. 12).
    Milliseconds(u32),
    /// Microseconds, as the `%` commands send it.
    Microseconds(u64),
}

impl Stamp {
    /// Decodes 4 or 11 characters. A time of 11 characters has 66 bits, and must fit in 64.
    pub(super) fn parse(characters: &[u8]) -> Result<Self, MalformedError> {
        let number = number(characters);
        let stamp = match characters.len() {
            4 => u32::try_from(number).map(Self::Milliseconds),
            _ => u64::try_from(number).map(Self::Microseconds),
        };
        stamp.map_err(|_| MalformedError::in_scip2(0, "a time below 2^64", quoted(characters)))
    }

    /// Time since the clock was last at 0.
    pub const fn since_zero(self) -> Duration {
        match self {
            Self::Milliseconds(number) => Duration::from_millis(number as u64),
            Self::Microseconds(number) => Duration::from_micros(number),
        }
    }
}

/// Scan of a reply to `G` or `M`. One allocation holds all its values.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Scan {
    /// Time of the sensor's clock at step 0 of the scan (p. 12).
    pub stamp: Stamp,
    /// Number of scans that a stream with an end will still send. 0 for an endless stream.
    pub left: u8,
    /// All distances, then all intensities.
    values: Arc<[u32]>,
    points: usize,
}

impl Scan {
    pub(super) fn parse(
        stamp: Stamp,
        left: u8,
        data: &[u8],
        kind: Data,
        points: usize,
    ) -> Result<Self, MalformedError> {
        let characters = points * kind.characters();
        let count = if kind == Data::Intensities { 2 * points } else { points };
        let mut values: Arc<[u32]> = repeat_n(0, count).collect();
        let slots = Arc::get_mut(&mut values).unwrap_or_default();
        let is_right_length = data.len() + 1 == characters + 2 * characters.div_ceil(LINE);
        let is_whole = kind != Data::ShortDistances
            && is_right_length
            && decode(data, slots, kind == Data::Intensities);
        if !is_whole {
            block(data, 1, characters)?;
            let full = data.split(|&byte| byte == b'\n').flat_map(|line| line.split_last());
            let characters: Vec<u8> =
                full.flat_map(|(_, characters)| characters).copied().collect();
            for (slot, value) in slots.iter_mut().zip(characters.chunks(2)) {
                *slot = number(value) as u32;
            }
        }
        Ok(Self { stamp, left, values, points })
    }

    /// All distances, then all intensities.
    pub(crate) fn into_values(self) -> Arc<[u32]> {
        self.values
    }

    /// Distances in millimetres, 18 bits, in the order of their steps. Which values are no distance
    /// depends on the model: [`Geometry::measurement`](crate::Geometry::measurement) knows.
    pub fn distances(&self) -> &[u32] {
        self.values.get(..self.points).unwrap_or_default()
    }

    /// Intensities, 18 bits, in the order of their steps. Empty unless asked for.
    pub fn intensities(&self) -> &[u32] {
        self.values.get(self.points..).unwrap_or_default()
    }
}

/// Decodes lines of values of three characters. Returns true if each line has the right shape,
/// characters and sum, for data of the right length. `in_pairs`: distances and intensities by turns.
fn decode(data: &[u8], values: &mut [u32], in_pairs: bool) -> bool {
    let (blocks, rest) = data.as_chunks();
    let last = full_block(rest);
    let mut out = [0; VALUES];
    let mut is_whole = true;
    if in_pairs {
        let (distances, intensities) = values.split_at_mut(values.len() / 2);
        let slots = distances.chunks_mut(VALUES / 2).zip(intensities.chunks_mut(VALUES / 2));
        for (block, (distances, intensities)) in blocks.iter().chain([&last]).zip(slots) {
            is_whole &= decode_blocks(from_ref(block), from_mut(&mut out));
            let slots = distances.iter_mut().zip(intensities);
            for ((distance, intensity), pair) in slots.zip(out.as_chunks().0) {
                [*distance, *intensity] = *pair;
            }
        }
    } else {
        let (whole, rest) = values.split_at_mut(values.len().min(VALUES * blocks.len()));
        is_whole &= decode_blocks(blocks, whole.as_chunks_mut().0);
        is_whole &= decode_blocks(from_ref(&last), from_mut(&mut out));
        rest.iter_mut().zip(out).for_each(|(slot, value)| *slot = value);
    }
    is_whole
}

/// Fills up less than three lines with characters that stand for 0. The last line has no LF.
fn full_block(rest: &[u8]) -> [u8; BLOCK] {
    let mut block = [FIRST_CHARACTER; BLOCK];
    let mut lines = rest.chunks(FULL);
    for [slots @ .., sum, end] in block.as_chunks_mut::<FULL>().0 {
        *end = b'\n';
        let line = lines.next().unwrap_or_default();
        if let Ok([characters @ .., found, found_end]) = <&[u8; FULL]>::try_from(line) {
            (*slots, *sum, *end) = (*characters, *found, *found_end);
        } else if let Some((&found, characters)) = line.split_last() {
            slots.iter_mut().zip(characters).for_each(|(slot, &character)| *slot = character);
            // The sum of the characters that are missing.
            let added = FIRST_CHARACTER.wrapping_mul((LINE - characters.len()) as u8);
            let six = found.wrapping_sub(FIRST_CHARACTER);
            *sum = if six < 64 { (six.wrapping_add(added) & 63) + FIRST_CHARACTER } else { found };
        }
    }
    block
}

/// Decodes blocks of three full lines. True if each line has characters only, its sum and its LF.
///
/// No branch depends on a byte, so that the compiler uses vector instructions. It does so in one
/// copy of this loop, but not in several.
#[inline(never)]
fn decode_blocks(blocks: &[[u8; BLOCK]], values: &mut [[u32; VALUES]]) -> bool {
    let (mut seen, mut faults) = ([0; LINE], 0);
    for (block, values) in blocks.iter().zip(values) {
        let mut sixes = [0; 3 * LINE];
        let lines = block.as_chunks::<FULL>().0.iter();
        for ([line @ .., sum, end], sixes) in lines.zip(sixes.as_chunks_mut::<LINE>().0) {
            // 64 characters have the sum of their numbers: 64 times 0x30 has no low bits.
            let mut expected = 0u8;
            for ((character, six), seen) in line.iter().zip(sixes).zip(&mut seen) {
                *six = character.wrapping_sub(FIRST_CHARACTER);
                expected = expected.wrapping_add(*six);
                *seen |= *six;
            }
            let expected = [(expected & 63) + FIRST_CHARACTER, b'\n'];
            faults |= u16::from_le_bytes([*sum, *end]) ^ u16::from_le_bytes(expected);
        }
        join(&sixes, values);
    }
    faults == 0 && seen.iter().fold(0, |all, six| all | six) < 64
}

/// Joins each three numbers of six bits into a value.
#[cfg(not(all(feature = "simd", target_feature = "sse2")))]
fn join(sixes: &[u8; 3 * LINE], values: &mut [u32; VALUES]) {
    for (&[a, b, c], value) in sixes.as_chunks().0.iter().zip(values) {
        *value = u32::from(a) << 12 | u32::from(b) << 6 | u32::from(c);
    }
}

/// Joins each three numbers of six bits into a value. Left to itself, the compiler takes more than twice the
/// instructions: SSE2 cannot shuffle bytes.
#[cfg(all(feature = "simd", target_feature = "sse2"))]
fn join(sixes: &[u8; 3 * LINE], values: &mut [u32; VALUES]) {
    // What the first and the second number of each word count in its value.
    let firsts = m128i::from([4096i16, 1, 0, 64, 4096, 1, 0, 64]);
    let seconds = m128i::from([64i16, 0, 4096, 1, 64, 0, 4096, 1]);
    for (sixes, values) in sixes.as_chunks::<48>().0.iter().zip(values.as_chunks_mut::<16>().0) {
        let &[a, b, c] = sixes.as_chunks::<16>().0 else { return };
        let [a, b, c] = [a, b, c].map(m128i::from);
        // Twelve numbers are six words and make four values, which need words 0, 1, 1, 2, 3, 4, 4 and 5.
        let pairs = [
            shuffle_ai_f32_all_m128i::<0b10_01_01_00>(a),
            shuffle_ai_f32_all_m128i::<0b11_10_10_00>(across::<0b01_00_11_11>(a, b)),
            shuffle_ai_f32_all_m128i::<0b10_01_01_00>(across::<0b00_00_11_10>(b, c)),
            shuffle_ai_f32_all_m128i::<0b11_10_10_01>(c),
        ];
        for (words, values) in pairs.into_iter().zip(values.as_chunks_mut().0) {
            let words = shuffle_ai_i16_l64all_m128i::<0b10_01_01_00>(words);
            let words = shuffle_ai_i16_h64all_m128i::<0b11_10_10_01>(words);
            let (first, second) =
                (words & m128i::from([0xffu16; 8]), shr_imm_u16_m128i::<8>(words));
            let first = mul_i16_horizontal_add_m128i(first, firsts);
            *values = (first | mul_i16_horizontal_add_m128i(second, seconds)).into();
        }
    }
}

/// Picks two words of 32 bits from `low`, then two from `high`.
#[cfg(all(feature = "simd", target_feature = "sse2"))]
fn across<const PICKED: i32>(low: m128i, high: m128i) -> m128i {
    let [low, high] = [low, high].map(cast_to_m128_from_m128i);
    cast_to_m128i_from_m128(shuffle_abi_f32_all_m128::<PICKED>(low, high))
}
