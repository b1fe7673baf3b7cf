//! The `urg` program.
fn main() {}
