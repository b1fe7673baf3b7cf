//! [`ErrorChain`]: an error and its causes on one line.

use std::fmt;

/// Error and its causes on one line: `Display` joins them with `: `.
///
/// Leaves out a cause whose text already ends the line: some errors include it. Wraps any error.
///
/// ```
/// use tokio_scip::{Error, ErrorChain};
///
/// let error = Error::open("/dev/ttyACM0", std::io::Error::other("device removed"));
/// assert_eq!(error.to_string(), "cannot open /dev/ttyACM0");
/// assert_eq!(ErrorChain(&error).to_string(), "cannot open /dev/ttyACM0: device removed");
/// ```
#[derive(Debug, Clone, Copy)]
pub struct ErrorChain<'a>(pub &'a (dyn std::error::Error + 'a));

impl fmt::Display for ErrorChain<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut last = self.0.to_string();
        f.write_str(&last)?;
        let mut cause = self.0.source();
        while let Some(error) = cause {
            let text = error.to_string();
            if !last.ends_with(&text) {
                write!(f, ": {text}")?;
                last = text;
            }
            cause = error.source();
        }
        Ok(())
    }
}
