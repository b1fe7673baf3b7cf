//! Properties that hold for any file. Each takes a script of bytes, so that these tests and the
//! fuzzer (`tests/fuzz` of the driver) run the same code.

pub(crate) mod damaged_files;
mod parts;
mod recordings;
#[path = "../../../tests/properties/script.rs"]
mod script;

use proptest::prelude::*;

proptest! {
    #[test]
    fn any_file_is_read_and_repaired(script in prop::collection::vec(any::<u8>(), 0..60)) {
        recordings::any_file_is_read_and_repaired(&script);
    }

    #[test]
    fn the_index_leads_to_the_same_part(script in prop::collection::vec(any::<u8>(), 0..40)) {
        parts::the_index_leads_to_the_same_part(&script);
    }
}

/// Without the checksum of its first chunk, a damaged beginning hides the channels, which the
/// index has, and the first scans.
#[test]
fn a_part_counts_from_the_first_readable_scan() {
    parts::the_index_leads_to_the_same_part(&[0, 9, 9, 0x41, 0, 0, 0x7e, 1, 9, 0, 0, 0, 0x8a]);
}
