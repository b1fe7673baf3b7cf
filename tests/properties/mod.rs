//! Properties that hold for any bytes. Each takes a script of bytes, so that these tests
//! and the fuzzer (`tests/fuzz`) run the same code.

mod commands;
#[cfg(feature = "mcap")]
pub(crate) mod damaged_files;
mod driver;
mod framing;
#[cfg(feature = "mcap")]
mod parts;
mod peer;
#[cfg(feature = "mcap")]
mod recordings;
mod replies;
mod script;
mod versions;

use proptest::prelude::*;

use crate::common::test_port;

proptest! {
    #[test]
    fn every_line_is_answered_as_the_table_says(script in prop::collection::vec(any::<u8>(), 0..100)) {
        commands::every_line_is_answered_as_the_table_says(&script);
    }

    #[test]
    fn chunks_make_no_difference(script in prop::collection::vec(any::<u8>(), 0..500)) {
        framing::chunks_make_no_difference(&script);
    }

    #[test]
    fn the_driver_stands_any_port_and_any_user(script in prop::collection::vec(any::<u8>(), 0..120)) {
        driver::the_driver_stands_any_port_and_any_user(&script);
    }

    #[test]
    fn only_what_the_text_allows_is_accepted(script in prop::collection::vec(any::<u8>(), 0..60)) {
        replies::only_what_the_text_allows_is_accepted(&script);
    }

    #[cfg(feature = "mcap")]
    #[test]
    fn any_file_is_read_and_repaired(script in prop::collection::vec(any::<u8>(), 0..60)) {
        recordings::any_file_is_read_and_repaired(&script);
    }

    #[cfg(feature = "mcap")]
    #[test]
    fn the_index_leads_to_the_same_part(script in prop::collection::vec(any::<u8>(), 0..40)) {
        parts::the_index_leads_to_the_same_part(&script);
    }

    #[test]
    fn every_line_of_a_version_is_kept(script in prop::collection::vec(any::<u8>(), 0..200)) {
        versions::every_line_of_a_version_is_kept(&script);
    }
}
