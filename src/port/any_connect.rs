//! [`AnyConnect`]: a [`Connect`] of any type, behind a pointer.
//!
//! With it the driver has one type, and is compiled with this crate. A driver generic over the
//! connector would be compiled again in your program, which takes seconds (`benches/README.md`, item 8).

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
