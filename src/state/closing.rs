//! [`Closing`]: whether a handle waits for the driver to close.

use std::sync::Arc;

/// Tells the driver that a handle waits for its end. If the caller drops that future, the driver
/// continues, so a `CancellationToken` does not fit: it stays cancelled.
#[derive(Debug, Default)]
pub(crate) struct Closing(Arc<()>);

impl Closing {
    /// Announces that the driver is closing, until the guard is dropped.
    #[must_use]
    pub(crate) fn announce(&self) -> Arc<()> {
        Arc::clone(&self.0)
    }

    /// Returns true while the driver is closing. A silent sensor then gets no second try.
    pub(crate) fn is_announced(&self) -> bool {
        Arc::strong_count(&self.0) > 1
    }
}
