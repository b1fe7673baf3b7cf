//! [`Finding`]: result of one step of the self-test.

use std::fmt;

use crate::output::notice::escaped;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Verdict {
    Ok,
    Weak,
    Failed,
}

/// What a step of the self-test found, and its verdict.
#[derive(Debug, Clone)]
pub(super) struct Finding {
    pub(super) name: &'static str,
    pub(super) verdict: Verdict,
    /// Includes the reason if the verdict is not ok.
    text: String,
}

impl Finding {
    pub(super) fn new(name: &'static str, verdict: Verdict, text: impl Into<String>) -> Self {
        Self { name, verdict, text: text.into() }
    }

    pub(super) fn ok(name: &'static str, text: impl Into<String>) -> Self {
        Self::new(name, Verdict::Ok, text)
    }

    pub(super) fn weak(name: &'static str, text: impl Into<String>) -> Self {
        Self::new(name, Verdict::Weak, text)
    }

    pub(super) fn failed(name: &'static str, text: impl Into<String>) -> Self {
        Self::new(name, Verdict::Failed, text)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.verdict {
            Verdict::Ok => "ok",
            Verdict::Weak => "weak",
            Verdict::Failed => "FAILED",
        };
        // An error names the port, and the name of a file may hold anything.
        write!(f, "{verdict:<7} {:<8} {}", self.name.replace('_', " "), escaped(&self.text))
    }
}
