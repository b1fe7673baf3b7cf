//! `urg`: use a URG sensor from the command line. This file parses the arguments, runs the
//! command, and maps its outcome to an exit code.

// A build without one of these commands has code that only they use.
#![cfg_attr(not(all(feature = "serve", feature = "view")), allow(dead_code))]

mod args;
mod check;
mod commands;
mod delivery;
mod failure;
mod format;
mod interrupt;
mod output;
#[cfg(any(feature = "serve", feature = "view"))]
mod picture;
#[cfg(any(feature = "serve", feature = "view"))]
mod playback;
mod plot;
mod port;
#[cfg(any(feature = "dds", feature = "zenoh", feature = "foxglove"))]
mod publish;
mod record;
mod recording;
mod stream;
#[cfg(feature = "view")]
mod view;
mod wait;
#[cfg(feature = "serve")]
mod web;

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::check::Check;
#[cfg(not(any(feature = "dds", feature = "zenoh", feature = "foxglove")))]
use crate::commands::absent::Publish;
#[cfg(not(feature = "serve"))]
use crate::commands::absent::Serve;
#[cfg(not(feature = "view"))]
use crate::commands::absent::View;
use crate::commands::baud::Baud;
use crate::commands::cut::Cut;
use crate::commands::emulate::Emulate;
use crate::commands::info::Info;
use crate::commands::laser::Laser;
use crate::commands::list::List;
use crate::commands::packaging::{Completions, Manual};
#[cfg(any(feature = "dds", feature = "zenoh", feature = "foxglove"))]
use crate::commands::publish::Publish;
use crate::commands::reboot::Reboot;
use crate::commands::repair::Repair;
use crate::commands::scan::ScanOnce;
#[cfg(feature = "serve")]
use crate::commands::serve::Serve;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::{escaped, notice};
use crate::output::stderr;
use crate::port::open::close_all;
use crate::record::Record;
use crate::stream::command::Stream;
#[cfg(feature = "view")]
use crate::view::View;

/// Use Hokuyo laser range scanners.
///
/// Data goes to standard output, everything else to standard error. Exit codes:
/// 0 when done or stopped by Ctrl-C, 1 on failure, 2 for an invalid command line.
/// Set RUST_LOG=debug to log what the driver does.
#[derive(Debug, Parser)]
#[command(
    name = "urg",
    // Without it, help texts on Windows say `urg.exe`.
    bin_name = "urg",
    version,
    arg_required_else_help = true,
    after_help = HELP
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(List),
    Info(Info),
    Scan(ScanOnce),
    Stream(Stream),
    View(View),
    Record(Record),
    Cut(Cut),
    Repair(Repair),
    Check(Check),
    Serve(Serve),
    Publish(Publish),
    Laser(Laser),
    Baud(Baud),
    Reboot(Reboot),
    Emulate(Emulate),
    Completions(Completions),
    Man(Manual),
}

/// Last part of the help: forms of PORT, and examples.
const HELP: &str = "\
PORT is one of
  /dev/ttyACM0, COM3      a serial port; /dev/serial/by-path/... names stay the same
  serial:H0713090         the sensor of this serial number, wherever it is plugged in
  tcp://HOST              a sensor on Ethernet, such as tcp://192.168.0.10
  tcp://HOST:PORT         a raw TCP bridge to a serial port; ?baud=N for its baud rate
  FILE.mcap               a recording, replayed as a sensor; also the folder of a ROS 2 bag
  -                       a recording on standard input
  emulated                a sensor in software, to try things out

Examples:
  urg list                                  list the serial ports
  urg info /dev/ttyACM0                     identify a sensor, and show its settings
  urg view emulated                         a live radar, without any hardware
  urg stream emulated --count 20            20 scans, without any hardware
  urg record /dev/ttyACM0 run.mcap          record, then replay: urg view run.mcap
  urg emulate --link /tmp/urg               an emulated sensor for other programs";

fn main() -> ExitCode {
    let outcome = match arguments().map(Cli::try_parse_from) {
        Err(failure) => Err(failure),
        Ok(Ok(cli)) => {
            start_log(&cli.command);
            run(cli)
        }
        Ok(Err(error)) if error.use_stderr() => refuse(&error),
        // Help and version are data on standard output, so write errors matter.
        Ok(Err(help)) => help
            .print()
            .and_then(|()| io::stdout().flush())
            .map_err(|error| output::stdout::failure(&error)),
    };
    let code = match outcome {
        Ok(()) | Err(Failure::PipeClosed | Failure::Interrupted) => ExitCode::SUCCESS,
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

/// Rejects an invalid command line, and exits.
fn refuse(error: &clap::Error) -> ! {
    let is_plain = |argument: OsString| !argument.to_string_lossy().contains(char::is_control);
    if std::env::args_os().all(is_plain) {
        error.exit();
    }
    // clap repeats an argument verbatim, and `urg view *` takes it from a file name.
    error.render().to_string().lines().for_each(|line| eprintln!("{}", escaped(line)));
    std::process::exit(error.exit_code())
}

/// Reads the arguments. Drops `--help` after `help`, where clap expects a command.
fn arguments() -> Result<Vec<OsString>, Failure> {
    let mut arguments: Vec<_> = std::env::args_os().collect();
    if arguments.get(1).is_some_and(|command| command == "help") {
        arguments.retain(|argument| argument != "--help" && argument != "-h");
    }
    #[cfg(any(feature = "dds", feature = "zenoh", feature = "foxglove"))]
    if arguments.get(1).is_some_and(|command| command == "publish") {
        let nodes = |arguments: &[OsString]| match Cli::try_parse_from(arguments) {
            Ok(Cli { command: Command::Publish(publish) }) => publish.nodes(),
            _ => Vec::new(),
        };
        return publish::ros_args::as_options(arguments, nodes);
    }
    Ok(arguments)
}

fn run(cli: Cli) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::new("cannot start", &error))?;
    let outcome = runtime.block_on(run_command(cli.command));
    runtime.block_on(close_all());
    // Does not wait for a blocked write to a pipe.
    runtime.shutdown_background();
    outcome
}

async fn run_command(command: Command) -> Result<(), Failure> {
    let has_trigger = matches!(&command, Command::Record(record) if record.before.is_some());
    let interrupt = Interrupt::listen(has_trigger)
        .map_err(|error| Failure::new("cannot listen for signals", &error))?;
    match command {
        // These handle the interrupt themselves.
        Command::Check(check) => check.run(&interrupt).await,
        Command::View(view) => view.run(&interrupt).await,
        Command::Record(record) => record.run(&interrupt).await,
        Command::Cut(cut) => cut.run(&interrupt).await,
        Command::Repair(repair) => repair.run(&interrupt).await,
        // These handle it too, but a reader, client or engine that hangs must not prevent the exit.
        Command::Stream(stream) => interrupt.limit(stream.run(&interrupt)).await,
        Command::Serve(serve) => interrupt.limit(serve.run(&interrupt)).await,
        Command::Publish(publish) => interrupt.limit(publish.run(&interrupt)).await,
        // These can be dropped at any await.
        Command::List(list) => interrupt.unless(list.run()).await,
        Command::Info(info) => interrupt.unless(info.run()).await,
        Command::Emulate(emulate) => interrupt.unless(emulate.run()).await,
        Command::Completions(shell) => interrupt.unless(shell.run(Cli::command())).await,
        Command::Man(man) => interrupt.unless(man.run(Cli::command())).await,
        // So can these, but a script would take success for work that is done.
        Command::Scan(scan) => interrupt.or_fail(scan.run()).await,
        Command::Laser(laser) => interrupt.or_fail(laser.run()).await,
        Command::Baud(baud) => interrupt.or_fail(baud.run()).await,
        Command::Reboot(reboot) => interrupt.or_fail(reboot.run()).await,
    }
}

/// Logs to standard error if you set `RUST_LOG`. Essential messages are notices, which need no log.
fn start_log(command: &Command) {
    let Some(wanted) = std::env::var_os("RUST_LOG") else { return };
    if matches!(command, Command::View(_)) && io::stderr().is_terminal() {
        notice("no log: its lines would cover the radar; add `2> urg.log` to log to a file");
        return;
    }
    // `EnvFilter` also matches span fields, but depends on a regular expression engine.
    match wanted.to_string_lossy().parse::<Targets>() {
        Ok(targets) => {
            let is_coloured = std::env::var_os("NO_COLOR").is_none_or(|set| set.is_empty());
            let lines = tracing_subscriber::fmt::layer()
                .with_writer(|| stderr::LogWriter)
                .with_ansi(is_coloured && stderr::accepts_escape_codes());
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
