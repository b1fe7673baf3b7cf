//! Properties that hold for any bytes. Each takes a script of bytes, so that these tests
//! and the fuzzer (`tests/fuzz`) run the same code.

mod driver;
mod framing;
mod peer;
mod peer_scip2;
mod replies;
mod scip2;
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

    #[test]
    fn only_scans_of_scip_2_are_accepted(script in prop::collection::vec(any::<u8>(), 0..80)) {
        scip2::only_scans_of_the_text_are_accepted(&script);
    }

    #[test]
    fn any_bytes_of_scip_2_are_judged(script in prop::collection::vec(any::<u8>(), 0..300)) {
        scip2::any_bytes_are_judged(&script);
    }

    #[test]
    fn whole_scans_of_scip_2_are_decoded(script in prop::collection::vec(any::<u8>(), 0..40)) {
        scip2::whole_scans_are_decoded(&script);
    }
}

proptest! {
    // Each case flips every bit of a frame.
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn flipped_bits_of_scip_2_are_refused(script in prop::collection::vec(any::<u8>(), 0..40)) {
        scip2::flipped_bits_and_missing_ends_are_refused(&script);
    }

    #[test]
    fn flipped_bits_in_an_identity_are_refused(script in prop::collection::vec(any::<u8>(), 0..200)) {
        scip2::flipped_bits_in_an_identity_are_refused(&script);
    }
}
