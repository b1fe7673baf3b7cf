//! Requests from handles to the driver, and their queue. Each request is answered exactly
//! once: by the driver, or when it is dropped with the driver.

use std::collections::VecDeque;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};

use crate::protocol::Version;
use crate::ring::Cursor;
use crate::{BaudRate, ErrorKind, Rate, Scan, Window};

/// Sender for the answer to a request.
pub(crate) type Responder<T> = oneshot::Sender<Result<T, ErrorKind>>;

/// Request from a handle.
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
    /// Returns true if no caller waits for the answer any more.
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

    fn fail(self, error: ErrorKind) {
        // Drops the answer if no caller waits for it.
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

/// Request on its way to the driver. Boxed, because the channel allocates 32 slots from the
/// start.
#[derive(Debug)]
pub(crate) struct QueuedRequest {
    pub(crate) request: Request,
    /// When to fail if there is still no link.
    pub(crate) expires: Instant,
}

/// Smallest number of waiting requests that is worth checking for abandoned ones.
const PURGE_FROM: usize = 64;

/// Request that can be answered without a link.
#[derive(Debug)]
pub(crate) enum Unlinked {
    Subscribe { window: Window, rate: Rate, depth: usize, responder: Responder<Cursor> },
    Close(Responder<()>),
}

/// All handles and streams are gone.
#[derive(Debug)]
pub(crate) struct Abandoned;

/// Receiving end of the queue: first come, first served.
#[derive(Debug)]
pub(crate) struct RequestQueue {
    receiver: mpsc::Receiver<Box<QueuedRequest>>,
    /// Requests that wait for a link, oldest first. The first one expires first, because all
    /// wait equally long.
    waiting: VecDeque<Box<QueuedRequest>>,
    /// When this many requests wait, the driver drops the abandoned ones. It is twice the number
    /// left last time, so each request is checked only a few times.
    purge_at: usize,
    /// Next request, if it was already taken from the channel.
    next: Option<Box<QueuedRequest>>,
}

impl RequestQueue {
    pub(crate) fn new(receiver: mpsc::Receiver<Box<QueuedRequest>>) -> Self {
        Self { receiver, waiting: VecDeque::new(), purge_at: PURGE_FROM, next: None }
    }

    /// Returns the next request, or `None` if the queue is empty.
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

    /// Waits until [`pop`](Self::pop) has a request. Cancel-safe.
    pub(crate) async fn ready(&mut self) -> Result<(), Abandoned> {
        if self.waiting.is_empty() && self.next.is_none() {
            self.next = Some(self.receiver.recv().await.ok_or(Abandoned)?);
        }
        Ok(())
    }

    /// While there is no link: returns the next request that needs none. The others wait
    /// until they expire with `Disconnected`. Cancel-safe.
    pub(crate) async fn next_unlinked(&mut self) -> Result<Unlinked, Abandoned> {
        loop {
            if let Some(queued) = self.next.take().filter(|queued| !queued.request.is_abandoned()) {
                match queued.request {
                    Request::Subscribe { window, rate, depth, responder } => {
                        return Ok(Unlinked::Subscribe { window, rate, depth, responder });
                    }
                    Request::Close(responder) => return Ok(Unlinked::Close(responder)),
                    _ => self.wait(queued),
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

    /// Queues a request until there is a link.
    fn wait(&mut self, queued: Box<QueuedRequest>) {
        self.waiting.push_back(queued);
        if self.waiting.len() >= self.purge_at {
            self.waiting.retain(|queued| !queued.request.is_abandoned());
            self.purge_at = PURGE_FROM.max(2 * self.waiting.len());
        }
    }

    fn expire(&mut self) {
        let now = Instant::now();
        while self.waiting.front().is_some_and(|queued| queued.expires <= now) {
            if let Some(queued) = self.waiting.pop_front() {
                queued.request.fail(ErrorKind::disconnected(None));
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
        let mut queue = RequestQueue::new(receiver);
        assert!(queue.ready().now_or_never().is_none(), "no request was sent");
        let (responder, _answer) = oneshot::channel();
        let expires = Instant::now() + Duration::from_secs(1);
        let queued = Box::new(QueuedRequest { request: Request::Version(responder), expires });
        assert!(sender.send(queued).await.is_ok());
        assert!(queue.next_unlinked().now_or_never().is_none(), "it needs a link");
        assert!(matches!(queue.ready().now_or_never(), Some(Ok(()))));
        assert!(matches!(queue.pop(), Ok(Some(Request::Version(_)))));
    }

    #[tokio::test(start_paused = true)]
    async fn abandoned_requests_do_not_wait_until_they_expire() {
        let (sender, receiver) = mpsc::channel(1);
        let mut queue = RequestQueue::new(receiver);
        let expires = Instant::now() + Duration::from_secs(3600);
        let mut answers = Vec::new();
        for number in 0..10_000 {
            let (responder, answer) = oneshot::channel();
            let request = Request::Version(responder);
            assert!(sender.send(Box::new(QueuedRequest { request, expires })).await.is_ok());
            assert!(queue.next_unlinked().now_or_never().is_none(), "it waits for a link");
            // One in a hundred is kept. The others are abandoned while they wait.
            answers.extend((number % 100 == 0).then_some(answer));
            assert!(queue.waiting.len() < 2 * answers.len() + PURGE_FROM, "{number}");
        }
        let mut kept = 0;
        while let Ok(Some(_)) = queue.pop() {
            kept += 1;
        }
        assert_eq!(kept, answers.len());
    }
}
