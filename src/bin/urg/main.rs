//! The `urg` program: a URG sensor on the command line. Here are the list of
//! commands, and the way from the arguments to the exit code.

mod args;
mod check;
mod commands;
mod delivery;
mod failure;
mod format;
mod interrupt;
mod output;
mod playback;
mod plot;
mod port;
#[cfg(any(feature = "ros2", feature = "zenoh"))]
mod publish;
mod recording;
mod stream;
mod view;
#[cfg(feature = "web")]
mod web;

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::commands::{
    baud, check as self_test, completions, emulate, info, laser, list, man, publish as publishing,
    record, repair, scan, serve, stream as streaming, view as radar,
};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::output::stderr;

/// Talks to Hokuyo URG laser range sensors that speak SCIP 1.1.
///
/// Data goes to standard output, everything else to standard error. Exit codes:
/// 0 when done or stopped by Ctrl-C, 1 on failure, 2 for an invalid command line.
/// RUST_LOG=debug logs what the driver does.
#[derive(Debug, Parser)]
#[command(
    name = "urg",
    // Not `urg.exe`.
    bin_name = "urg",
    version,
    arg_required_else_help = true,
    after_help = help()
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(list::List),
    Info(info::Info),
    Scan(scan::ScanOnce),
    Stream(streaming::Stream),
    View(radar::View),
    Record(record::Record),
    Repair(repair::Repair),
    Check(self_test::Check),
    Serve(serve::Serve),
    Publish(publishing::Publish),
    Laser(laser::Laser),
    Baud(baud::Baud),
    Emulate(emulate::Emulate),
    Completions(completions::Completions),
    #[command(hide = true)]
    Man(man::Manual),
}

/// Returns the help's last part: the forms of PORT, and examples.
fn help() -> String {
    let (recording, record) = match recording::AVAILABLE {
        true => (
            "\n  FILE.mcap               a recording, replayed as a sensor",
            "\n  urg record /dev/ttyACM0 run.mcap          record, then replay: urg view run.mcap",
        ),
        false => ("", ""),
    };
    format!(
        "\
PORT is one of
  /dev/ttyACM0, COM3      a serial port; /dev/serial/by-path/... names stay the same
  serial:H0713090         the sensor of this serial number, wherever it is plugged in
  tcp://HOST:PORT         a raw TCP bridge to a serial port; ?baud=N for its baud rate{recording}
  emulated                a sensor in software, to try things out

Examples:
  urg list                                  list the serial ports
  urg info /dev/ttyACM0                     identify a sensor, and show its settings
  urg view emulated                         a live radar, without any hardware
  urg stream emulated --count 20            20 scans, without any hardware{record}
  urg emulate --link /tmp/urg               an emulated sensor for other programs"
    )
}

fn main() -> ExitCode {
    let outcome = match Cli::try_parse_from(arguments()) {
        Ok(cli) => {
            start_log(&cli.command);
            run(cli)
        }
        Err(error) if error.use_stderr() => error.exit(),
        // Help and the version are data: a full disk is reported.
        Err(help) => help
            .print()
            .and_then(|()| io::stdout().flush())
            .map_err(|error| output::stdout::failure(&error)),
    };
    let code = match outcome {
        Ok(()) | Err(Failure::PipeClosed) => ExitCode::SUCCESS,
        Err(Failure::Failed(line)) => {
            notice(line);
            ExitCode::FAILURE
        }
        Err(Failure::Usage(line)) => {
            notice(line);
            ExitCode::from(2)
        }
    };
    stderr::finish();
    code
}

/// Returns the arguments. Leaves out `--help` behind `help`, where clap expects a command.
fn arguments() -> Vec<OsString> {
    let mut arguments: Vec<_> = std::env::args_os().collect();
    if arguments.get(1).is_some_and(|command| command == "help") {
        arguments.retain(|argument| argument != "--help" && argument != "-h");
    }
    arguments
}

fn run(cli: Cli) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::of("cannot start", &error))?;
    let outcome = runtime.block_on(run_command(cli.command));
    // Does not wait for a write to a pipe that nobody reads.
    runtime.shutdown_background();
    outcome
}

/// Runs `command` until it is done or interrupted.
async fn run_command(command: Command) -> Result<(), Failure> {
    let interrupt =
        Interrupt::listen().map_err(|error| Failure::of("cannot listen for signals", &error))?;
    match command {
        // These end in good order by themselves.
        Command::Stream(stream) => stream.run(&interrupt).await,
        Command::Check(check) => check.run(&interrupt).await,
        Command::View(view) => view.run(&interrupt).await,
        Command::Record(record) => record.run(&interrupt).await,
        Command::Repair(repair) => repair.run(&interrupt).await,
        Command::Serve(serve) => serve.run(&interrupt).await,
        Command::Publish(publish) => publish.run(&interrupt).await,
        // These can be stopped anywhere.
        Command::List(list) => interrupt.or(list.run()).await,
        Command::Info(info) => interrupt.or(info.run()).await,
        Command::Scan(scan) => interrupt.or(scan.run()).await,
        Command::Laser(laser) => interrupt.or(laser.run()).await,
        Command::Baud(baud) => interrupt.or(baud.run()).await,
        Command::Emulate(emulate) => interrupt.or(emulate.run()).await,
        Command::Completions(completions) => interrupt.or(completions.run(Cli::command())).await,
        Command::Man(man) => interrupt.or(man.run(Cli::command())).await,
    }
}

/// Logs to standard error as `RUST_LOG` asks for, and not at all without it:
/// whatever a user has to know is a notice.
fn start_log(command: &Command) {
    let Some(wanted) = std::env::var_os("RUST_LOG") else { return };
    if matches!(command, Command::View(_)) && io::stderr().is_terminal() {
        notice("no log: its lines would cover the radar; add `2> urg.log` to log to a file");
        return;
    }
    // Targets and levels. `EnvFilter`, which also matches the fields of spans, needs an
    // engine for regular expressions.
    match wanted.to_string_lossy().parse::<Targets>() {
        Ok(targets) => {
            let lines = tracing_subscriber::fmt::layer()
                .with_writer(|| stderr::LogWriter)
                .with_ansi(stderr::accepts_escape_codes());
            tracing_subscriber::registry().with(lines).with(targets).init();
        }
        Err(error) => notice(format_args!("no log: RUST_LOG is invalid: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
    }
}
