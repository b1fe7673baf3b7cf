//! JSON: one line for each thing.

use serde::Serialize;

use crate::failure::Failure;

/// Returns `data` as one line, which ends in LF.
pub(crate) fn line(data: &impl Serialize) -> Result<String, Failure> {
    let mut line = text(data)?;
    line.push('\n');
    Ok(line)
}

/// Returns `data` as JSON without a line break.
pub(crate) fn text(data: &impl Serialize) -> Result<String, Failure> {
    serde_json::to_string(data).map_err(|error| Failure::of("cannot write JSON", &error))
}
