//! The state that all request handlers share.

use std::sync::Arc;

use super::hub::Hub;
use super::viewers::Viewers;
use crate::interrupt::Interrupt;

/// The shared state.
#[derive(Debug, Clone)]
pub(super) struct App {
    pub(super) hub: Arc<Hub>,
    pub(super) viewers: Arc<Viewers>,
    pub(super) interrupt: Interrupt,
}
