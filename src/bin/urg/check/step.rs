//! A step of the self-test, and its verdict.

use std::fmt;

use tokio_scip::Error;

use crate::failure::chain;

/// The outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Verdict {
    Ok,
    Weak,
    Failed,
}

/// A step and its verdict.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) verdict: Verdict,
    /// The findings, and the reason if they are not good.
    text: String,
}

impl Step {
    pub(crate) fn new(name: &'static str, verdict: Verdict, text: impl Into<String>) -> Self {
        Self { name, verdict, text: text.into() }
    }

    pub(crate) fn failed(name: &'static str, error: &Error) -> Self {
        Self::new(name, Verdict::Failed, chain(error))
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.verdict {
            Verdict::Ok => "ok",
            Verdict::Weak => "weak",
            Verdict::Failed => "FAILED",
        };
        write!(f, "{verdict:<7} {:<8} {}", self.name, self.text)
    }
}
