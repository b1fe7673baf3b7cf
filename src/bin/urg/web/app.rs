//! The state that all request handlers share.

use std::sync::Arc;

use super::source::Source;
use super::viewers::Viewers;
use crate::interrupt::Interrupt;

/// The shared state.
#[derive(Debug, Clone)]
pub(super) struct App {
    pub(super) sources: Arc<[Source]>,
    pub(super) viewers: Arc<Viewers>,
    pub(super) interrupt: Interrupt,
}
