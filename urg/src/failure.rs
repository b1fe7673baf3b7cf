//! Reasons to exit early, and errors formatted as one line for the user.

use std::error::Error;
use std::fmt;

/// Reason to exit early.
#[derive(Debug, Clone)]
pub(crate) enum Failure {
    /// Invalid command line: exit code 2, as for clap's own errors.
    Usage(String),
    Failed(String),
    /// The reader of standard output, such as `head`, closed the pipe: exit code 0.
    PipeClosed,
    /// The user stopped the program before it had anything to finish: exit code 0.
    Interrupted,
}

impl Failure {
    /// Describes `what` and then `error` with its causes, in one line.
    pub(crate) fn new(what: impl fmt::Display, error: &dyn Error) -> Self {
        Self::Failed(format!("{what}: {}", chain(error)))
    }

    /// Describes an error on `port`, with its causes.
    pub(crate) fn at(port: impl fmt::Display, error: &dyn Error) -> Self {
        Self::on(port, chain(error))
    }

    /// Describes what went wrong on `port`. Adds the port unless the line already names it.
    pub(crate) fn on(port: impl fmt::Display, line: String) -> Self {
        match line.contains(&port.to_string()) {
            true => Self::Failed(line),
            false => Self::Failed(format!("{port}: {line}")),
        }
    }

    /// Adds what to do.
    pub(crate) fn advise(self, advice: impl fmt::Display) -> Self {
        match self {
            Self::Failed(line) => Self::Failed(format!("{line}; {advice}")),
            other => other,
        }
    }

    /// Message for the user; empty if the exit code is 0.
    pub(crate) fn line(&self) -> &str {
        match self {
            Self::Usage(line) | Self::Failed(line) => line,
            Self::PipeClosed | Self::Interrupted => "",
        }
    }
}

/// Joins an error and its causes with ": ".
pub(crate) fn chain(error: &dyn Error) -> String {
    tokio_scip::ErrorChain(error).to_string()
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    fn line(error: tokio_scip::Error) -> String {
        match Failure::at("/dev/ttyACM0", &error) {
            Failure::Failed(line) => line,
            other => format!("{other:?}"),
        }
    }

    #[test]
    fn a_failure_names_its_port_once_and_each_cause_once() {
        let open = tokio_scip::Error::open("/dev/ttyACM0", io::Error::other("on fire"));
        assert_eq!(line(open), "cannot open /dev/ttyACM0: on fire");
        let ended = "/dev/ttyACM0: the driver of the sensor has ended";
        assert_eq!(line(tokio_scip::ErrorKind::Closed.into()), ended);
    }
}
