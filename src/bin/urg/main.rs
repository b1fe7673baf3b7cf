//! The `urg` program: what a URG sensor can do, on the command line. Only the
//! way from the arguments to the exit code is here.

mod args;
mod commands;
#[cfg(feature = "mcap")]
mod contents;
mod failure;
mod feed;
mod follow;
mod format;
mod interrupt;
mod notice;
mod output;
mod pace;
mod plot;
mod port;
#[cfg(feature = "mcap")]
mod progress;
#[cfg_attr(not(feature = "mcap"), path = "unrecorded.rs")]
mod recorded;
#[cfg(feature = "mcap")]
mod recorder_file;
mod selftest;
mod view;
#[cfg(feature = "web")]
mod web;

use std::io::{self, IsTerminal};
use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

use crate::args::Cli;
use crate::failure::Failure;
use crate::notice::notice;

fn main() -> ExitCode {
    let cli = Cli::parse();
    if cli.command.draws() && io::stderr().is_terminal() {
        // Its lines would be drawn across the picture.
        if std::env::var_os(EnvFilter::DEFAULT_ENV).is_some() {
            notice("no log on the terminal that is drawn on: add `2> urg.log`");
        }
    } else {
        log_to_stderr();
    }
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run(cli: Cli) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::of("cannot start", &error))?;
    let outcome = runtime.block_on(commands::run(cli.command));
    // A write to a pipe that nobody reads may be under way: not waited for.
    runtime.shutdown_background();
    outcome
}

/// Logs as `RUST_LOG` asks for, and not at all without it: what a user has to
/// know is a notice.
fn log_to_stderr() {
    if std::env::var_os(EnvFilter::DEFAULT_ENV).is_none() {
        return;
    }
    match EnvFilter::try_from_default_env() {
        Ok(filter) => tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(io::stderr)
            .with_ansi(io::stderr().is_terminal())
            .init(),
        Err(error) => notice(format_args!("no log, RUST_LOG cannot be read: {error}")),
    }
}
