//! What handles ask the driver for. Each request is answered exactly once: by
//! the driver, or by being dropped with it.

use std::collections::VecDeque;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};

use crate::protocol::Version;
use crate::ring::Cursor;
use crate::{BaudRate, Error, Rate, Scan, Window};

/// Where the answer to a request goes.
pub(crate) type Promise<T> = oneshot::Sender<Result<T, Error>>;

/// Something that a handle asks for.
#[derive(Debug)]
pub(crate) enum Request {
    Version(Promise<Version>),
    Laser { on: bool, promise: Promise<()> },
    BaudRate { baud_rate: BaudRate, promise: Promise<()> },
    Scan { window: Window, promise: Promise<Scan> },
    Subscribe { window: Window, rate: Rate, promise: Promise<Cursor> },
    Close(Promise<()>),
}

impl Request {
    /// True if nobody waits for the answer any more.
    fn is_abandoned(&self) -> bool {
        match self {
            Self::Version(promise) => promise.is_closed(),
            Self::Laser { promise, .. } | Self::BaudRate { promise, .. } | Self::Close(promise) => {
                promise.is_closed()
            }
            Self::Scan { promise, .. } => promise.is_closed(),
            Self::Subscribe { promise, .. } => promise.is_closed(),
        }
    }

    fn fail(self, error: Error) {
        // An answer that nobody waits for is dropped.
        match self {
            Self::Version(promise) => drop(promise.send(Err(error))),
            Self::Laser { promise, .. } | Self::BaudRate { promise, .. } | Self::Close(promise) => {
                drop(promise.send(Err(error)))
            }
            Self::Scan { promise, .. } => drop(promise.send(Err(error))),
            Self::Subscribe { promise, .. } => drop(promise.send(Err(error))),
        }
    }
}

/// A request on its way to the driver.
#[derive(Debug)]
pub(crate) struct QueuedRequest {
    pub(crate) request: Request,
    /// When to give up if there is no link by then.
    pub(crate) expires: Instant,
}

/// A request that can be answered without a link.
#[derive(Debug)]
pub(crate) enum Unlinked {
    Subscribe { window: Window, rate: Rate, promise: Promise<Cursor> },
    Close(Promise<()>),
}

/// All handles and streams are gone.
#[derive(Debug)]
pub(crate) struct Abandoned;

/// The driver's end of the queue, first come, first served.
#[derive(Debug)]
pub(crate) struct RequestQueue {
    receiver: mpsc::Receiver<QueuedRequest>,
    /// Taken out of the channel and not served yet.
    waiting: VecDeque<QueuedRequest>,
}

impl RequestQueue {
    pub(crate) fn new(receiver: mpsc::Receiver<QueuedRequest>) -> Self {
        Self { receiver, waiting: VecDeque::new() }
    }

    /// The next request, if one is there.
    pub(crate) fn pop(&mut self) -> Result<Option<Request>, Abandoned> {
        loop {
            let letter = match self.waiting.pop_front() {
                Some(letter) => letter,
                None => match self.receiver.try_recv() {
                    Ok(letter) => letter,
                    Err(mpsc::error::TryRecvError::Empty) => return Ok(None),
                    Err(mpsc::error::TryRecvError::Disconnected) => return Err(Abandoned),
                },
            };
            if !letter.request.is_abandoned() {
                return Ok(Some(letter.request));
            }
        }
    }

    /// Waits until there is a request to [`pop`](Self::pop). Cancel-safe.
    pub(crate) async fn ready(&mut self) -> Result<(), Abandoned> {
        if self.waiting.is_empty() {
            let letter = self.receiver.recv().await.ok_or(Abandoned)?;
            self.waiting.push_back(letter);
        }
        Ok(())
    }

    /// While there is no link: gives out the requests that need none, and lets
    /// the others wait until they expire with `Disconnected`. Cancel-safe.
    pub(crate) async fn next_unlinked(&mut self) -> Result<Unlinked, Abandoned> {
        loop {
            self.waiting.retain(|letter| !letter.request.is_abandoned());
            let unlinked = |letter: &QueuedRequest| {
                matches!(letter.request, Request::Subscribe { .. } | Request::Close(_))
            };
            let place = self.waiting.iter().position(unlinked);
            match place.and_then(|place| self.waiting.remove(place)).map(|letter| letter.request) {
                Some(Request::Subscribe { window, rate, promise }) => {
                    return Ok(Unlinked::Subscribe { window, rate, promise });
                }
                Some(Request::Close(promise)) => return Ok(Unlinked::Close(promise)),
                _ => {}
            }
            self.expire();
            let first = self.waiting.iter().map(|letter| letter.expires).min();
            tokio::select! {
                biased;
                letter = self.receiver.recv() => self.waiting.push_back(letter.ok_or(Abandoned)?),
                () = sleep_until(first.unwrap_or_else(Instant::now)), if first.is_some() => {}
            }
        }
    }

    fn expire(&mut self) {
        let now = Instant::now();
        for letter in std::mem::take(&mut self.waiting) {
            if letter.expires > now {
                self.waiting.push_back(letter);
            } else {
                letter.request.fail(Error::disconnected(None));
            }
        }
    }

    /// Answers everything that is still queued.
    pub(crate) fn end(&mut self, error: &Error) {
        self.receiver.close();
        while let Some(letter) = self.waiting.pop_front() {
            letter.request.fail(error.clone());
        }
        while let Ok(letter) = self.receiver.try_recv() {
            letter.request.fail(error.clone());
        }
    }
}
