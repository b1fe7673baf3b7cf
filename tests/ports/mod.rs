//! Ports: endpoints, TCP, pseudo-terminals and real terminals.

mod endpoints;
#[cfg(all(unix, feature = "serial"))]
mod serial;
#[cfg(feature = "tcp")]
mod tcp;
#[cfg(all(unix, feature = "serial"))]
mod terminal;
