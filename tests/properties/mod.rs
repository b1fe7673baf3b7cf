//! Properties that hold for any bytes. Each takes a script of bytes, so that these tests
//! and the fuzzer (`tests/fuzz`) run the same code.

mod driver;
mod framing;
mod peer;
mod replies;
mod script;
mod versions;

use proptest::prelude::*;

use crate::common::test_port;

proptest! {
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

    #[test]
    fn every_line_of_a_version_is_kept(script in prop::collection::vec(any::<u8>(), 0..200)) {
        versions::every_line_of_a_version_is_kept(&script);
    }
}
