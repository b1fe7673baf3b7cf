//! [`AnyConnect`]: a [`Connect`] of any type, behind a pointer.
//!
//! With it the driver has one type, and is compiled with this crate. Were it generic over the
//! connector, each program that uses the crate would compile it again, which takes seconds of
//! each of its builds (`benches/README.md`, item 8).

use std::future::Future;
use std::pin::Pin;

use super::{Connect, Port};
use crate::Error;

/// The future of [`AnyConnect::connect`].
type Connecting<'a> = Pin<Box<dyn Future<Output = Result<Box<dyn Port>, Error>> + Send + 'a>>;

/// The methods of [`Connect`], on a trait object.
pub(crate) trait AnyConnect: Send {
    fn connect(&mut self) -> Connecting<'_>;
    fn name(&self) -> Option<&str>;
    fn has_more(&self) -> bool;
    fn found(&mut self);
    fn expected_serial_number(&self) -> Option<&str>;
}

impl<C: Connect> AnyConnect for C {
    fn connect(&mut self) -> Connecting<'_> {
        Box::pin(async { Ok(Box::new(Connect::connect(self).await?) as Box<dyn Port>) })
    }

    fn name(&self) -> Option<&str> {
        Connect::name(self)
    }

    fn has_more(&self) -> bool {
        Connect::has_more(self)
    }

    fn found(&mut self) {
        Connect::found(self);
    }

    fn expected_serial_number(&self) -> Option<&str> {
        Connect::expected_serial_number(self)
    }
}
