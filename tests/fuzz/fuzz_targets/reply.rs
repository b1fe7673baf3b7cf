//! See `tests/properties/replies.rs`.
#![no_main]

#[path = "../../properties/replies.rs"]
mod replies;
#[path = "../../properties/script.rs"]
mod script;

libfuzzer_sys::fuzz_target!(|data: &[u8]| replies::only_what_the_text_allows_is_accepted(data));
