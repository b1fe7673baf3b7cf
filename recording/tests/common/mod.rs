//! Helpers that the tests of the driver have, too.

#[path = "../../../tests/common/limit.rs"]
pub(crate) mod limit;
#[path = "../../../tests/common/random.rs"]
pub(crate) mod random;
