//! SCIP 1.1 as a sensor speaks it, written from the protocol text alone.
//!
//! `command` parses what the host sends, `device` executes it, `encode` writes the reply.
//! They use only the type `BaudRate` of the driver, so that the driver
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
    fn the_driver_gives_this_module_only_baud_rates() {
        for source in
            [include_str!("command.rs"), include_str!("device.rs"), include_str!("encode.rs")]
        {
            let mut uses = source.split("tokio_scip").skip(1);
            assert!(uses.all(|used| used.starts_with("::BaudRate;")));
        }
    }
}
