//! What the sums of SCIP 2 show of damage to a scan, and what they cannot: counted over every
//! byte, and every pair of bits of a line. The sums here share no code with the crate.

use tokio_scip::Window;
use tokio_scip::protocol::scip2::{Command, Content, Data, Reply, Request};

use super::encoder::indoors;

/// First byte of the data: after echo, status and clock, each with its line feed.
const DATA: usize = "GD0044072501\n00P\n00000\n".len();
/// Characters of a full line, and its length with sum and line feed.
const FULL: usize = 64;
const LINE: usize = FULL + 2;

fn request(frame: &[u8]) -> Request {
    let last = if frame.starts_with(b"GD00440725") { 725 } else { 86 };
    let window = Window::new(44..=last).unwrap();
    Request::new(Command::Latest { data: Data::Distances, window }, None)
}

fn sum(text: &[u8]) -> u8 {
    b'0' + (text.iter().map(|&byte| u32::from(byte)).sum::<u32>() % 64) as u8
}

/// A scan as measured indoors, without its terminator: of all steps, or of two lines.
fn frame(last: u16) -> Vec<u8> {
    let values = indoors(usize::from(last) - 43).into_iter().map(u32::from);
    let data: Vec<u8> =
        values.flat_map(|v| [12, 6, 0].map(|shift| b'0' + (v >> shift) as u8 % 64)).collect();
    let mut frame = format!("GD0044{last:04}01\n00P\n00000").into_bytes();
    for line in data.chunks(FULL) {
        frame.extend([b"\n", line, &[sum(line)]].concat());
    }
    frame
}

/// Values of a scan, or none if it is refused.
fn distances(frame: &[u8]) -> Option<Vec<u32>> {
    match Reply::parse(&request(frame), frame).ok()?.content {
        Content::Scan(scan) => Some(scan.distances().to_vec()),
        _ => None,
    }
}

fn flip(frame: &[u8], bits: &[usize]) -> Vec<u8> {
    let mut frame = frame.to_vec();
    bits.iter().for_each(|bit| frame[bit / 8] ^= 1 << (bit % 8));
    frame
}

#[test]
fn w26_one_damaged_byte_is_always_detected() {
    let whole = frame(86);
    assert!(distances(&whole).is_some());
    for at in 0..whole.len() {
        for byte in (0..=255).filter(|byte| *byte != whole[at]) {
            let mut damaged = whole.clone();
            damaged[at] = byte;
            assert_eq!(distances(&damaged), None, "{byte:#04x} at {at}");
        }
        assert_eq!(distances(&[&whole[..at], &whole[at + 1..]].concat()), None, "without {at}");
        let more = [&whole[..at], &whole[at..=at], &whole[at..]].concat();
        assert_eq!(distances(&more), None, "{at} twice");
    }
}

#[test]
fn w27_swapped_characters_and_lines_are_not_detected() {
    let whole = frame(725);
    let right = distances(&whole).unwrap();
    let (mut swaps, mut changed) = (0, 0);
    for at in (DATA..whole.len() - 1).filter(|at| (at - DATA) % LINE < FULL - 1) {
        let mut damaged = whole.clone();
        damaged.swap(at, at + 1);
        // Not with the sum of the last line.
        let Some(found) = distances(&damaged) else { continue };
        swaps += 1;
        changed += usize::from(found != right);
    }
    println!("{swaps} swaps of neighbours pass, {changed} change a value");
    assert!(swaps >= 1900 && changed > swaps / 3, "{swaps} {changed}");
    let line = |number: usize| DATA + number * LINE..DATA + number * LINE + LINE;
    let mut damaged = whole.clone();
    damaged[line(3)].copy_from_slice(&whole[line(4)]);
    damaged[line(4)].copy_from_slice(&whole[line(3)]);
    assert_ne!(distances(&damaged).unwrap(), right);
}

#[test]
fn w27_two_flipped_bits_may_cancel_each_other_out() {
    let whole = frame(86);
    let line = 8 * DATA..8 * (DATA + FULL + 1);
    let (mut pairs, mut passed) = (0, 0);
    for first in line.clone() {
        for second in first + 1..line.end {
            let is_accepted = distances(&flip(&whole, &[first, second])).is_some();
            // Not two bits in a row.
            assert!(!is_accepted || second > first + 1, "{first}");
            pairs += 1;
            passed += usize::from(is_accepted);
        }
        // In two lines, each sum shows its own.
        let other = 8 * (DATA + LINE) + first % (8 * FULL);
        assert_eq!(distances(&flip(&whole, &[first, other])), None, "{first}");
    }
    println!("{passed} of {pairs} pairs of flipped bits in a line pass");
    assert!((pairs / 100..pairs / 20).contains(&passed), "{passed}");
}
