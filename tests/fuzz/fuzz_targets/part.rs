//! See `recording/tests/properties/parts.rs`.
#![no_main]

#[path = "../../../recording/tests/properties/damaged_files.rs"]
mod damaged_files;
#[path = "../../../recording/tests/properties/parts.rs"]
mod parts;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| parts::the_index_leads_to_the_same_part(data));
