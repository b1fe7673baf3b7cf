//! [`ParameterError`]: a number or a text that makes no parameter.

use super::Text;

/// Error for an invalid baud rate, [`Rate`](crate::Rate), or parameter of a command of SCIP 2.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid {parameter} {found:?}: expected {expected}")]
pub struct ParameterError {
    parameter: &'static str,
    expected: &'static str,
    found: Text,
}

impl ParameterError {
    pub(crate) fn new(
        parameter: &'static str,
        expected: &'static str,
        found: impl ToString,
    ) -> Self {
        Self { parameter, expected, found: found.to_string().into() }
    }
}
