//! See `recording/tests/properties/recordings.rs`.
#![no_main]

#[path = "../../../recording/tests/properties/damaged_files.rs"]
mod damaged_files;
#[path = "../../../recording/tests/properties/recordings.rs"]
mod recordings;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| recordings::any_file_is_read_and_repaired(data));
