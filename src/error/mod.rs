//! [`Error`]: everything that can fail, for the crate's users. Errors of the protocol
//! itself are in [`protocol`](crate::protocol).

mod chain;
mod kind;

use std::fmt;
use std::io;
use std::sync::Arc;

pub use self::chain::ErrorChain;
use self::kind::Sentence;
pub use self::kind::{ErrorKind, Operation};
use crate::protocol::{MalformedError, ParameterError, ReplyError, WindowError};

/// Why an operation failed, and what to do about it.
///
/// Match its [`kind`](Self::kind) to decide what to do:
///
/// ```
/// use tokio_scip::{Error, ErrorKind};
///
/// fn is_unplugged(error: &Error) -> bool {
///     matches!(error.kind(), ErrorKind::NoSuchPort { .. } | ErrorKind::Disconnected { .. })
/// }
/// # let port = "/dev/ttyACM0".to_owned();
/// # assert!(is_unplugged(&ErrorKind::NoSuchPort { port }.into()));
/// ```
///
/// `Display` writes one line without the cause; [`source`](std::error::Error::source) returns it.
/// In a log, write [`ErrorChain`], which has both. `{:?}` writes the same: a `main` that returns the
/// error tells your user what to do. `{:#?}` writes the kind with all its fields, for a bug report.
///
/// An error is a pointer, and cheap to clone: all callers that wait for one event get the same error.
///
/// A direction without a distance is not an error but a [`Measurement`](crate::Measurement).
#[derive(Clone)]
pub struct Error(Arc<ErrorParts>);

#[derive(Clone)]
struct ErrorParts {
    kind: ErrorKind,
    sensor: Option<Arc<str>>,
}

impl Error {
    /// Creates the error of a sensor with this name, if it has one.
    pub(crate) fn new(kind: ErrorKind, sensor: Option<&Arc<str>>) -> Self {
        Self(Arc::new(ErrorParts { kind, sensor: sensor.cloned() }))
    }

    /// Creates an [`ErrorKind::Open`], for a [`Connect`](crate::port::Connect) of your own.
    pub fn open(port: impl Into<String>, source: io::Error) -> Self {
        ErrorKind::Open { port: port.into(), source: Arc::new(source) }.into()
    }

    /// Wraps an error of another type of this crate.
    pub(crate) fn other(source: impl std::error::Error + Send + Sync + 'static) -> Self {
        ErrorKind::Other { source: Arc::new(source) }.into()
    }

    /// What failed.
    pub fn kind(&self) -> &ErrorKind {
        &self.0.kind
    }

    pub(crate) fn into_kind(self) -> ErrorKind {
        Arc::unwrap_or_clone(self.0).kind
    }

    /// Name of the sensor that this error concerns: the [name](crate::SensorBuilder::name) given to it,
    /// or else the name of its port. `None` if neither has a name, as with
    /// [`attach`](crate::SensorBuilder::attach), and for an error that no driver has made.
    pub fn sensor(&self) -> Option<&str> {
        self.0.sensor.as_deref()
    }

    /// Returns true if you can try again later without changing anything: the link may come back, or
    /// the next scan may be whole. This applies to [`NoSuchPort`](ErrorKind::NoSuchPort),
    /// [`NoSuchSensor`](ErrorKind::NoSuchSensor), [`Busy`](ErrorKind::Busy), [`Open`](ErrorKind::Open),
    /// [`NoAnswer`](ErrorKind::NoAnswer), [`Rejected`](ErrorKind::Rejected),
    /// [`Disconnected`](ErrorKind::Disconnected), [`Timeout`](ErrorKind::Timeout),
    /// [`Malformed`](ErrorKind::Malformed) and [`NotConfirmed`](ErrorKind::NotConfirmed). For the
    /// others, change the machine, the sensor or the program first. A driver that has ended stays ended.
    pub fn is_transient(&self) -> bool {
        self.kind().is_transient()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Sentence { kind: self.kind(), sensor: self.sensor().unwrap_or("the sensor") }.fmt(f)
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if f.alternate() {
            let ErrorParts { kind, sensor } = &*self.0;
            return f.debug_struct("Error").field("kind", kind).field("sensor", sensor).finish();
        }
        // Not `Debug` of the chain, which would come back here.
        fmt::Display::fmt(&ErrorChain(self), f)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.kind().source()
    }
}

/// Creates an error without the name of a sensor. A driver adds the name.
impl From<ErrorKind> for Error {
    fn from(kind: ErrorKind) -> Self {
        Self::new(kind, None)
    }
}

/// `?` converts every error type of this crate. The other conversions are beside their types.
macro_rules! convert {
    ($($error:ty),+) => {
        $(impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::other(error)
            }
        })+
    };
}

convert!(MalformedError, ParameterError, ReplyError, WindowError);

impl From<std::convert::Infallible> for Error {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}
