//! A link from its opening through its settings to its loss and its return.

mod candidates;
mod identity;
mod idle_probe;
mod logging;
mod opening;
mod port_end;
pub(crate) mod reconnect;
mod settings;
