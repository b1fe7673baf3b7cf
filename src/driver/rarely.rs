//! [`rarely`]: keeps what few scans need away from the code of every scan.

use std::pin::Pin;

/// Makes a future in a box. The compiler moves the code that leads here to the end of its function
/// so that a scan without it touches fewer lines of the code cache.
#[cold]
#[inline(never)]
pub(super) fn rarely<F: Future>(make: impl FnOnce() -> F) -> Pin<Box<F>> {
    Box::pin(make())
}
