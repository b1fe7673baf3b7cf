//! Bytes on a serial line: how long they take, and what they turn into where
//! the two ends do not have the same speed.

use std::time::Duration;

/// What a sensor reaches on USB, in bytes a second (measured on a URG-04LX).
const USB_BYTES_PER_SECOND: u32 = 375_000;

/// How long one byte takes at `speed` bits a second, or on USB.
///
/// 10 bits a byte: one start, 8 data and one stop bit (C-42-3320-A p. 2).
pub(super) fn byte_time(speed: Option<u32>) -> Duration {
    let per_second = match speed {
        Some(bits) => bits.max(10) / 10,
        None => USB_BYTES_PER_SECOND,
    };
    Duration::from_nanos(1_000_000_000 / u64::from(per_second.max(1)))
}

/// What a receiver at one speed makes of bytes that were sent at another, in
/// bits a second.
///
/// A model of the hardware: the receiver waits for a falling edge, then samples
/// the middle of ten of its own bits. Faster receivers see several bytes for
/// one, slower ones miss most. A missing stop bit is not noticed, as on a
/// terminal in raw mode.
pub(super) fn garble(bytes: &[u8], sender: u32, receiver: u32) -> Vec<u8> {
    if sender == receiver || sender == 0 || receiver == 0 {
        return bytes.to_vec();
    }
    let total = bytes.len() * 10;
    let high = |bit: usize| match (bytes.get(bit / 10), bit % 10) {
        (None, _) | (Some(_), 9) => true,
        (Some(_), 0) => false,
        (Some(byte), n) => byte >> (n - 1) & 1 == 1,
    };
    // Where the middle of the receiver's n-th bit is, in bits of the sender.
    let middle = |n: u64| ((2 * n + 1) * u64::from(sender) / (2 * u64::from(receiver))) as usize;

    let mut received = Vec::new();
    let mut bit = 0;
    while bit < total {
        if high(bit) {
            bit += 1;
            continue;
        }
        let mut end = bit + 1;
        if !high(bit + middle(0)) {
            let byte = (0..8).fold(0, |byte, n| byte | u8::from(high(bit + middle(n + 1))) << n);
            received.push(byte);
            end = bit + middle(9).max(1);
        }
        // The line must be idle before the next falling edge can be seen.
        while end < total && !high(end) {
            end += 1;
        }
        bit = end;
    }
    received
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_speeds_change_nothing() {
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(garble(&all, 19_200, 19_200), all);
    }

    #[test]
    fn a_receiver_twice_as_fast_sees_each_bit_twice() {
        // 'U' is 0x55: on the line 0 1010 1010 1, so each falling edge is seen
        // as a start bit: 0 01 10 01 10, and 0 01 10 01 11 where the line ends idle.
        assert_eq!(garble(b"U", 19_200, 38_400), [0x66, 0xE6]);
    }

    #[test]
    fn a_slow_receiver_makes_one_byte_of_several() {
        // Of three NULs only the second one's stop bit is sampled, as bit 5.
        assert_eq!(garble(&[0, 0, 0], 57_600, 19_200), [0x20]);
    }

    #[test]
    fn different_speeds_never_leave_a_command_as_it_was() {
        let speeds = [19_200, 57_600, 115_200, 250_000, 500_000, 750_000];
        for sender in speeds {
            for receiver in speeds.into_iter().filter(|receiver| *receiver != sender) {
                assert_ne!(garble(b"G04472501\n", sender, receiver), b"G04472501\n");
            }
        }
    }

    #[test]
    fn a_byte_takes_ten_bits() {
        assert_eq!(byte_time(Some(19_200)), Duration::from_nanos(520_833));
        assert_eq!(byte_time(Some(500_000)), Duration::from_micros(20));
        assert_eq!(byte_time(None), Duration::from_nanos(2_666));
    }
}
