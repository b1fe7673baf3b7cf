//! Memory, allocations, floods, and each call that can fail.

mod allocations;
mod flood;
mod memory;
mod nth_failure;
mod reads;
