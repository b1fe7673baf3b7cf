//! [`AnyConnect`]: a [`Connect`] of any type, behind a pointer, and [`BoxConnect`], which
//! owns one.
//!
//! With it the driver has one type, and is compiled with this crate. A driver generic over the
//! connector would be compiled again in your program, which takes seconds of each build
//! (`benches/README.md`, item 8).

use std::fmt;
use std::future::Future;
use std::pin::Pin;

use super::{Connect, ConnectHints, Port};
use crate::Error;

/// Future of [`AnyConnect::connect`].
type Connecting<'a> = Pin<Box<dyn Future<Output = Result<Box<dyn Port>, Error>> + Send + 'a>>;

/// Methods of [`Connect`], on a trait object.
pub(crate) trait AnyConnect: Send {
    fn connect(&mut self) -> Connecting<'_>;
    fn name(&self) -> Option<&str>;
    fn hints(&mut self) -> Option<&mut dyn ConnectHints>;
}

impl<C: Connect> AnyConnect for C {
    fn connect(&mut self) -> Connecting<'_> {
        Box::pin(async { Ok(Box::new(Connect::connect(self).await?) as Box<dyn Port>) })
    }

    fn name(&self) -> Option<&str> {
        Connect::name(self)
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        Connect::hints(self)
    }
}

/// [`Connect`] of any type, made by [`Connect::boxed`].
///
/// ```
/// use urg_emulator::Emulator;
/// use tokio_scip::port::{BoxConnect, Connect, Endpoint};
///
/// let tcp: Endpoint = "tcp://robot:10940?baud=115200".parse()?;
/// let connectors: [BoxConnect; 2] = [tcp.into_connector().boxed(), Emulator::default().boxed()];
/// # assert_eq!(connectors[0].name(), Some("tcp://robot:10940?baud=115200"));
/// # Ok::<(), tokio_scip::Error>(())
/// ```
pub struct BoxConnect(Box<dyn AnyConnect>);

impl BoxConnect {
    pub(super) fn new(connect: impl Connect) -> Self {
        Self(Box::new(connect))
    }
}

impl Connect for BoxConnect {
    type Port = Box<dyn Port>;

    async fn connect(&mut self) -> Result<Box<dyn Port>, Error> {
        self.0.connect().await
    }

    fn name(&self) -> Option<&str> {
        self.0.name()
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        self.0.hints()
    }
}

impl fmt::Debug for BoxConnect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BoxConnect").field("name", &self.0.name()).finish_non_exhaustive()
    }
}
