//! The reasons why the program ends without having done what it was asked to,
//! and an error with its causes as one line. `main` reports them.

use std::error::Error;

/// A reason to end.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The command line makes no sense; exit code 2, as for clap's own errors.
    Usage(String),
    /// It did not work; exit code 1.
    Failed(String),
    /// The reader of standard output has closed it, as `head` does: a success.
    PipeClosed,
}

impl Failure {
    /// Describes `error` and its causes after `what`, in one line.
    pub(crate) fn of(what: &str, error: &dyn Error) -> Self {
        Self::Failed(format!("{what}: {}", chain(error)))
    }

    /// Describes an error on `port`, which is named where the error does not
    /// name it.
    pub(crate) fn at(port: &str, error: &dyn Error) -> Self {
        let line = chain(error);
        if line.contains(port) {
            Self::Failed(line)
        } else {
            Self::Failed(format!("{port}: {line}"))
        }
    }

    /// Returns the line for the user; none where nothing has failed.
    pub(crate) fn line(&self) -> &str {
        match self {
            Self::Usage(line) | Self::Failed(line) => line,
            Self::PipeClosed => "",
        }
    }
}

/// Returns an error and its causes, joined by ": ".
pub(crate) fn chain(error: &dyn Error) -> String {
    tokio_scip::ErrorChain::new(error).to_string()
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::Arc;

    use super::*;

    fn line(error: tokio_scip::Error) -> String {
        match Failure::at("/dev/ttyACM0", &error) {
            Failure::Failed(line) => line,
            other => format!("{other:?}"),
        }
    }

    #[test]
    fn a_failure_names_its_port_once_and_each_cause_once() {
        let source = || Arc::new(io::Error::other("on fire"));
        let port = "/dev/ttyACM0".to_owned();
        let open = tokio_scip::Error::Open { port, source: source() };
        assert_eq!(line(open), "cannot open /dev/ttyACM0: on fire");
        let off = "/dev/ttyACM0: the laser is switched off: switch it on before asking for scans";
        assert_eq!(line(tokio_scip::Error::LaserOff), off);
        let baud_rate = tokio_scip::BaudRate::B250000;
        let fixed = tokio_scip::Error::UnsupportedBaudRate { baud_rate, source: Some(source()) };
        assert_eq!(line(fixed), "/dev/ttyACM0: the port cannot be set to 250000 baud: on fire");
    }
}
