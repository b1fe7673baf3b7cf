//! Errors of a service that calls the crate with `?`.

use std::error::Error as StdError;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio_scip::protocol::{Command, MalformedError, ParameterError, Reply, ReplyError};
use tokio_scip::protocol::{Window, WindowError};
use tokio_scip::scan::ScanError;
use tokio_scip::state::StaleError;
use tokio_scip::{Error, ErrorChain, ErrorKind, Rate, Scan};
use urg_emulator::Emulator;

use crate::common::builder;

/// Converts an error as `?` does. Returns the name of its type.
fn convert<E: StdError + Clone + Into<Error> + 'static>(error: E) -> &'static str {
    let converted: Error = error.clone().into();
    assert_eq!(converted.to_string(), error.to_string());
    assert_eq!(converted.source().is_some(), error.source().is_some());
    let ErrorKind::Other { source, .. } = converted.kind() else { panic!("{converted:?}") };
    assert!(source.is::<E>(), "{source:?}");
    std::any::type_name::<E>().rsplit("::").next().unwrap()
}

/// Names of the public error types in a folder of sources.
fn error_types(folder: &std::path::Path, found: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            error_types(&path, found);
            continue;
        }
        for line in std::fs::read_to_string(&path).unwrap_or_default().lines() {
            let item = line.strip_prefix("pub struct ").or(line.strip_prefix("pub enum "));
            let name = item.and_then(|item| item.split(['(', ' ', '<']).next());
            found.extend(name.filter(|name| name.ends_with("Error")).map(str::to_owned));
        }
    }
}

#[tokio::test(start_paused = true)]
async fn every_error_converts_with_question_mark() {
    let sensor = builder().connect(Emulator::default()).await.unwrap();
    let stale = sensor.freshness().check(Duration::ZERO).unwrap_err();
    let mut converted = [
        convert::<WindowError>(Window::new(0..=10_000).unwrap_err()),
        convert::<ParameterError>("0".parse::<Rate>().unwrap_err()),
        convert::<ScanError>(Scan::builder(Window::FULL, [1]).build().unwrap_err()),
        convert::<ReplyError>(Reply::parse(&Command::Version, b"L1\n0").unwrap_err()),
        convert::<MalformedError>(MalformedError::NoData),
        convert::<StaleError>(stale),
    ];
    let mut public = Vec::new();
    error_types(&std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut public);
    public.retain(|name| name != "Error");
    public.sort();
    converted.sort_unstable();
    assert_eq!(public, converted);
}

#[test]
fn debug_writes_each_cause_once_and_alternate_debug_the_fields() {
    #[derive(Debug, thiserror::Error)]
    #[error("cannot start: {0}")]
    struct Outer(#[source] Error);

    let source = Some(Arc::new(io::Error::other("device removed")));
    let error = Error::from(ErrorKind::Disconnected { source });
    let text = "the link to the sensor is lost: device removed";
    assert_eq!(format!("{error:?}"), text);
    let fields = format!("{error:#?}");
    for part in ["Error {", "kind: Disconnected {", "\"device removed\"", "sensor: None"] {
        assert!(fields.contains(part), "{fields}");
    }
    assert_eq!(ErrorChain(&Outer(error)).to_string(), format!("cannot start: {text}"));
    assert!(size_of::<Result<(), Error>>() <= size_of::<usize>());
}
