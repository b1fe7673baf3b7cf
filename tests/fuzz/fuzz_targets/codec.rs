//! See `tests/properties/framing.rs`.
#![no_main]

#[path = "../../properties/framing.rs"]
mod framing;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| framing::chunks_make_no_difference(data));
