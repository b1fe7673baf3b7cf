//! See `emulator/tests/commands.rs`.
#![no_main]

#[path = "../../../emulator/tests/commands.rs"]
mod commands;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| commands::every_line_is_answered_as_the_table_says(data));
