//! The `urg` program: what a URG sensor can do, on the command line. Only the
//! way from the arguments to the exit code is here.

mod args;
mod commands;
mod failure;
mod format;
mod interrupt;
mod notice;
mod output;
mod pace;
mod port;

use std::io;
use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

use crate::args::Cli;
use crate::failure::Failure;
use crate::notice::notice;

fn main() -> ExitCode {
    let cli = Cli::parse();
    log_to_stderr();
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
            .with_ansi(io::IsTerminal::is_terminal(&io::stderr()))
            .init(),
        Err(error) => notice(format_args!("no log, RUST_LOG cannot be read: {error}")),
    }
}
