//! [`Attached`]: a stream that is open already, as a port that can be opened once.

use std::io;

use tokio::io::{AsyncRead, AsyncWrite};

use super::{Connect, StreamPort};
use crate::{Error, ErrorKind};

/// [`Connect`] that returns its stream once, and then fails.
#[derive(Debug)]
pub(crate) struct Attached<T>(Option<T>);

impl<T> Attached<T> {
    pub(crate) fn new(stream: T) -> Self {
        Self(Some(stream))
    }
}

impl<T> Connect for Attached<T>
where
    T: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    type Port = StreamPort<T>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let gone = || ErrorKind::disconnected(Some(io::ErrorKind::BrokenPipe.into()));
        Ok(self.0.take().map(StreamPort).ok_or_else(gone)?)
    }
}
