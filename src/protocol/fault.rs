//! [`MalformedError`] of SCIP 2. Here, because the error of the driver has it, too.

/// Fault in the shape of a reply: where it is, what was expected there, and what was found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected} in {}, found {found}", self.place())]
pub struct MalformedError {
    line: Option<usize>,
    expected: String,
    found: String,
}

impl MalformedError {
    /// Creates the error for a line after the status, or for no single line.
    pub(in crate::protocol) fn new(
        line: impl Into<Option<usize>>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self { line: line.into(), expected: expected.into(), found: found.into() }
    }

    /// Number of the line, from 0, after the status. `None` if the fault is in the status, or if a
    /// line is missing.
    pub(crate) const fn line(&self) -> Option<usize> {
        self.line
    }

    fn place(&self) -> String {
        self.line.map_or_else(|| "the reply".into(), |line| format!("line {line}"))
    }
}
