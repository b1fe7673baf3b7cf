//! See `tests/properties/scip2.rs`.
#![no_main]

#[path = "../../properties/scip2.rs"]
#[allow(dead_code, reason = "the other properties need no fuzzer")]
mod scip2;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    scip2::only_scans_of_the_text_are_accepted(data);
    scip2::any_bytes_are_judged(data);
});
