//! See `tests/properties/driver.rs`.
#![no_main]

#[path = "../../properties/driver.rs"]
mod driver;
#[path = "../../properties/peer.rs"]
mod peer;
#[path = "../../properties/peer_scip2.rs"]
mod peer_scip2;
#[path = "../../properties/script.rs"]
mod script;
#[path = "../../common/test_port.rs"]
mod test_port;

libfuzzer_sys::fuzz_target!(|data: &[u8]| driver::the_driver_stands_any_port_and_any_user(data));
