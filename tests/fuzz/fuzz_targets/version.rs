//! See `tests/properties/versions.rs`.
#![no_main]

#[path = "../../properties/versions.rs"]
mod versions;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| versions::every_line_of_a_version_is_kept(data));
