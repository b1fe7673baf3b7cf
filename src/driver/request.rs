//! Requests from handles to the driver, and their queue. Each request is answered
//! exactly once: by the driver, or by being dropped with it.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};

use crate::protocol::Version;
use crate::ring::Cursor;
use crate::{BaudRate, Error, Rate, Scan, Window};

/// The sender of the answer to a request.
pub(crate) type Responder<T> = oneshot::Sender<Result<T, Error>>;

/// A request of a handle.
#[derive(Debug)]
pub(crate) enum Request {
    Version(Responder<Version>),
    Laser { on: bool, responder: Responder<()> },
    BaudRate { baud_rate: BaudRate, responder: Responder<()> },
    Scan { window: Window, responder: Responder<Scan> },
    Subscribe { window: Window, rate: Rate, depth: usize, responder: Responder<Cursor> },
    Close(Responder<()>),
}

impl Request {
    /// Returns whether nobody waits for the answer any more.
    fn is_abandoned(&self) -> bool {
        match self {
            Self::Version(responder) => responder.is_closed(),
            Self::Laser { responder, .. }
            | Self::BaudRate { responder, .. }
            | Self::Close(responder) => responder.is_closed(),
            Self::Scan { responder, .. } => responder.is_closed(),
            Self::Subscribe { responder, .. } => responder.is_closed(),
        }
    }

    fn fail(self, error: Error) {
        // An answer that nobody waits for is dropped.
        match self {
            Self::Version(responder) => drop(responder.send(Err(error))),
            Self::Laser { responder, .. }
            | Self::BaudRate { responder, .. }
            | Self::Close(responder) => drop(responder.send(Err(error))),
            Self::Scan { responder, .. } => drop(responder.send(Err(error))),
            Self::Subscribe { responder, .. } => drop(responder.send(Err(error))),
        }
    }
}

/// A request on its way to the driver. Boxed in the channel, which has room for 32 from
/// the start.
#[derive(Debug)]
pub(crate) struct QueuedRequest {
    pub(crate) request: Request,
    /// The time to fail at if there is no link by then.
    pub(crate) expires: Instant,
}

/// A request that can be answered without a link.
#[derive(Debug)]
pub(crate) enum Unlinked {
    Subscribe { window: Window, rate: Rate, depth: usize, responder: Responder<Cursor> },
    Close(Responder<()>),
}

/// All handles and streams are gone.
#[derive(Debug)]
pub(crate) struct Abandoned;

/// The driver's end of the queue, first come, first served.
#[derive(Debug)]
pub(crate) struct RequestQueue {
    receiver: mpsc::Receiver<Box<QueuedRequest>>,
    /// The name of the sensor, for errors.
    name: Option<Arc<str>>,
    /// Requests that need a link, from the time when there was none; the first
    /// one expires first, since all wait equally long.
    waiting: VecDeque<Box<QueuedRequest>>,
    /// The request after those, if it was taken out of the channel already.
    next: Option<Box<QueuedRequest>>,
}

impl RequestQueue {
    pub(crate) fn new(
        receiver: mpsc::Receiver<Box<QueuedRequest>>,
        name: Option<Arc<str>>,
    ) -> Self {
        Self { receiver, name, waiting: VecDeque::new(), next: None }
    }

    /// Returns the next request, if one is there.
    pub(crate) fn pop(&mut self) -> Result<Option<Request>, Abandoned> {
        loop {
            let queued = match self.waiting.pop_front().or_else(|| self.next.take()) {
                Some(queued) => queued,
                None => match self.receiver.try_recv() {
                    Ok(queued) => queued,
                    Err(mpsc::error::TryRecvError::Empty) => return Ok(None),
                    Err(mpsc::error::TryRecvError::Disconnected) => return Err(Abandoned),
                },
            };
            if !queued.request.is_abandoned() {
                return Ok(Some(queued.request));
            }
        }
    }

    /// Waits until there is a request to [`pop`](Self::pop). Cancel-safe.
    pub(crate) async fn ready(&mut self) -> Result<(), Abandoned> {
        if self.waiting.is_empty() && self.next.is_none() {
            self.next = Some(self.receiver.recv().await.ok_or(Abandoned)?);
        }
        Ok(())
    }

    /// While there is no link: returns the next request that needs none, and lets
    /// the others wait until they expire with `Disconnected`. Looks at each
    /// request once. Cancel-safe.
    pub(crate) async fn next_unlinked(&mut self) -> Result<Unlinked, Abandoned> {
        loop {
            if let Some(queued) = self.next.take().filter(|queued| !queued.request.is_abandoned()) {
                match queued.request {
                    Request::Subscribe { window, rate, depth, responder } => {
                        return Ok(Unlinked::Subscribe { window, rate, depth, responder });
                    }
                    Request::Close(responder) => return Ok(Unlinked::Close(responder)),
                    _ => self.waiting.push_back(queued),
                }
            }
            self.expire();
            let first = self.waiting.front().map(|queued| queued.expires);
            tokio::select! {
                biased;
                queued = self.receiver.recv() => self.next = Some(queued.ok_or(Abandoned)?),
                () = sleep_until(first.unwrap_or_else(Instant::now)), if first.is_some() => {}
            }
        }
    }

    fn expire(&mut self) {
        let now = Instant::now();
        while self.waiting.front().is_some_and(|queued| queued.expires <= now) {
            if let Some(queued) = self.waiting.pop_front() {
                let error = Error::disconnected(None).named(self.name.as_ref());
                queued.request.fail(error);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use futures::FutureExt;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_request_that_waited_for_a_link_is_ready_when_there_is_one() {
        let (sender, receiver) = mpsc::channel(2);
        let mut queue = RequestQueue::new(receiver, None);
        assert!(queue.ready().now_or_never().is_none(), "no request was sent");
        let (responder, _answer) = oneshot::channel();
        let expires = Instant::now() + Duration::from_secs(1);
        let queued = Box::new(QueuedRequest { request: Request::Version(responder), expires });
        assert!(sender.send(queued).await.is_ok());
        assert!(queue.next_unlinked().now_or_never().is_none(), "it needs a link");
        assert!(matches!(queue.ready().now_or_never(), Some(Ok(()))));
        assert!(matches!(queue.pop(), Ok(Some(Request::Version(_)))));
    }
}
