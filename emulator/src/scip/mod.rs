//! SCIP 1.1 as a sensor speaks it, written from the protocol text alone.
//!
//! `command` parses what the host sends, `device` executes it, `encode` writes the reply.
//! They use only the type `BaudRate` of the crate's `protocol` module, so that the driver
//! and the emulated sensor check each other: a misreading of the text in either of them
//! fails a test.

mod command;
mod device;
mod encode;

pub(super) use self::command::{ArrivedCommand, HostCommand, LineBuffer};
pub(super) use self::device::{Device, Effect};
pub use self::device::{EmptyCommand, Firmware, Mode, RepeatedLaser};
pub(super) use self::encode::{scip2_scan, status_only};

#[cfg(test)]
mod tests {
    #[test]
    fn nothing_here_uses_the_drivers_reading_of_the_text() {
        for source in
            [include_str!("command.rs"), include_str!("device.rs"), include_str!("encode.rs")]
        {
            let mut uses = source.split("crate::").skip(1);
            assert!(
                uses.all(|used| used.starts_with("BaudRate;") || used.starts_with("emulator::"))
            );
            assert!(!source.contains("super::super"));
        }
    }
}
