//! The commands, one file each.

pub(crate) mod baud;
pub(crate) mod check;
pub(crate) mod completions;
pub(crate) mod emulate;
pub(crate) mod info;
pub(crate) mod laser;
pub(crate) mod list;
pub(crate) mod man;
#[cfg(feature = "mcap")]
pub(crate) mod record;
pub(crate) mod scan;
#[cfg(feature = "web")]
pub(crate) mod serve;
pub(crate) mod stream;
pub(crate) mod view;

use crate::args::Command;
use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Runs `command` until it is done or interrupted.
pub(crate) async fn run(command: Command) -> Result<(), Failure> {
    let interrupt =
        Interrupt::listen().map_err(|error| Failure::of("cannot listen for signals", &error))?;
    match command {
        // Ends by itself, with what has come by then written to its end.
        Command::Stream(stream) => stream.run(&interrupt).await,
        Command::Check(check) => check.run(&interrupt).await,
        Command::View(view) => view.run(&interrupt).await,
        #[cfg(feature = "mcap")]
        Command::Record(record) => record.run(&interrupt).await,
        // Ends its connections first.
        #[cfg(feature = "web")]
        Command::Serve(serve) => serve.run(&interrupt).await,
        Command::List(list) => or_interrupt(&interrupt, list.run()).await,
        Command::Info(info) => or_interrupt(&interrupt, info.run()).await,
        Command::Scan(scan) => or_interrupt(&interrupt, scan.run()).await,
        Command::Laser(laser) => or_interrupt(&interrupt, laser.run()).await,
        Command::Baud(baud) => or_interrupt(&interrupt, baud.run()).await,
        Command::Emulate(emulate) => or_interrupt(&interrupt, emulate.run()).await,
        Command::Completions(completions) => or_interrupt(&interrupt, completions.run()).await,
        Command::Man(man) => or_interrupt(&interrupt, man.run()).await,
    }
}

/// A command that can be stopped anywhere.
async fn or_interrupt(
    interrupt: &Interrupt,
    command: impl Future<Output = Result<(), Failure>>,
) -> Result<(), Failure> {
    tokio::select! {
        outcome = command => outcome,
        _ = interrupt.requested() => Ok(()),
    }
}
