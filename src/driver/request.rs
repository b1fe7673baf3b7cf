//! Requests of handles, and their queue. Each is answered once, by the driver or when dropped with it.

use std::collections::VecDeque;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};

use crate::protocol::scip2::State;
use crate::ring::Cursor;
use crate::state::LinkState;
use crate::{BaudRate, ErrorKind, Rate, Scan, Window};

/// Sender for the answer to a request.
pub(crate) type Responder<T> = oneshot::Sender<Result<T, ErrorKind>>;

/// Request from a handle.
#[derive(Debug)]
pub(crate) enum Request {
    /// Waits for a link.
    Link(Responder<()>),
    State(Responder<Option<State>>),
    Laser {
        on: bool,
        responder: Responder<()>,
    },
    BaudRate {
        baud_rate: BaudRate,
        responder: Responder<()>,
    },
    Reboot(Responder<()>),
    Scan {
        window: Window,
        responder: Responder<Scan>,
    },
    Subscribe {
        window: Window,
        rate: Rate,
        depth: usize,
        responder: Responder<Cursor>,
    },
    Close(Responder<()>),
    /// A stream was dropped.
    StreamDropped,
}

impl Request {
    /// Returns true if no caller waits for the answer any more.
    fn is_abandoned(&self) -> bool {
        match self {
            Self::State(responder) => responder.is_closed(),
            Self::Link(responder)
            | Self::Laser { responder, .. }
            | Self::BaudRate { responder, .. }
            | Self::Reboot(responder)
            | Self::Close(responder) => responder.is_closed(),
            Self::Scan { responder, .. } => responder.is_closed(),
            Self::Subscribe { responder, .. } => responder.is_closed(),
            Self::StreamDropped => false,
        }
    }

    fn fail(self, error: ErrorKind) {
        // Drops the answer if no caller waits for it.
        match self {
            Self::State(responder) => drop(responder.send(Err(error))),
            Self::Link(responder)
            | Self::Laser { responder, .. }
            | Self::BaudRate { responder, .. }
            | Self::Reboot(responder)
            | Self::Close(responder) => drop(responder.send(Err(error))),
            Self::Scan { responder, .. } => drop(responder.send(Err(error))),
            Self::Subscribe { responder, .. } => drop(responder.send(Err(error))),
            Self::StreamDropped => {}
        }
    }
}

/// What the service asked the sensor to be, recorded when the driver takes the request, even without a link.
#[derive(Debug, Default)]
pub(crate) struct DesiredSettings {
    pub(crate) laser: Option<bool>,
    /// Baud rate that the sensor has neither confirmed nor refused yet.
    pub(crate) baud_rate: Option<BaudRate>,
    /// Number of attempts to change to it without a caller.
    pub(crate) attempts: u8,
}

/// Smallest number of waiting requests that is worth checking for abandoned ones.
const PURGE_FROM: usize = 64;

/// All handles and streams are gone.
#[derive(Debug)]
pub(crate) struct Abandoned;

/// Receiving end of the queue: first come, first served.
#[derive(Debug)]
pub(crate) struct RequestQueue {
    /// Boxed requests, because the channel allocates 32 slots from the start.
    receiver: mpsc::Receiver<Box<Request>>,
    /// How long a request waits for a link.
    timeout: Duration,
    pub(crate) desired: DesiredSettings,
    /// Requests that wait for a link, oldest first, and when each fails if there is still none. The
    /// first one expires first, because all wait equally long.
    waiting: VecDeque<(Box<Request>, Instant)>,
    /// When this many requests wait, the driver drops the abandoned ones. It is twice the number
    /// left last time, so each request is checked only a few times.
    purge_at: usize,
    /// Next request, if it was already taken from the channel.
    next: Option<Box<Request>>,
}

impl RequestQueue {
    pub(crate) fn new(receiver: mpsc::Receiver<Box<Request>>, timeout: Duration) -> Self {
        let (desired, waiting) = (DesiredSettings::default(), VecDeque::new());
        Self { receiver, timeout, desired, waiting, purge_at: PURGE_FROM, next: None }
    }

    /// Returns the next request, or `None` if the queue is empty.
    pub(crate) fn pop(&mut self) -> Result<Option<Box<Request>>, Abandoned> {
        while let Some((request, _)) = self.waiting.pop_front() {
            if !request.is_abandoned() {
                return Ok(Some(request));
            }
        }
        let request = match self.next.take() {
            Some(request) => request,
            None => match self.receiver.try_recv() {
                Ok(request) => request,
                Err(mpsc::error::TryRecvError::Empty) => return Ok(None),
                Err(mpsc::error::TryRecvError::Disconnected) => return Err(Abandoned),
            },
        };
        if request.is_abandoned() {
            // A stream that was dropped while this one filled the queue could not say so.
            return Ok(Some(Box::new(Request::StreamDropped)));
        }
        self.desired.record(&request);
        Ok(Some(request))
    }

    /// Returns true if the next request that has waited for a link switches the laser.
    #[cold]
    #[inline(never)]
    pub(crate) fn begins_with_laser(&self) -> bool {
        let next = self.waiting.iter().find(|(request, _)| !request.is_abandoned());
        next.is_some_and(|(request, _)| matches!(**request, Request::Laser { .. }))
    }

    /// Lets the requests that still wait begin to wait anew, because the link is lost.
    pub(crate) fn lose_link(&mut self) {
        let anew = Instant::now() + self.timeout;
        self.waiting.iter_mut().for_each(|(_, expires)| *expires = anew);
    }

    /// Waits until [`pop`](Self::pop), which has returned `None`, has a request.
    pub(crate) fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Abandoned>> {
        self.next = Some(ready!(self.receiver.poll_recv(cx)).ok_or(Abandoned)?);
        Poll::Ready(Ok(()))
    }

    /// While there is no link: returns the next request. Those that [wait](Self::wait) expire with the
    /// reason why there is no link. Cancel-safe.
    pub(crate) async fn next_unlinked(&mut self, link: &LinkState) -> Result<Request, Abandoned> {
        loop {
            if let Some(request) = self.next.take().filter(|request| !request.is_abandoned()) {
                self.desired.record(&request);
                return Ok(*request);
            }
            self.expire(link);
            let first = self.waiting.front().map(|(_, expires)| *expires);
            tokio::select! {
                biased;
                request = self.receiver.recv() => self.next = Some(request.ok_or(Abandoned)?),
                () = sleep_until(first.unwrap_or_else(Instant::now)), if first.is_some() => {}
            }
        }
    }

    /// Queues a request until there is a link.
    pub(crate) fn wait(&mut self, request: Request) {
        let expires = Instant::now() + self.timeout;
        self.waiting.push_back((Box::new(request), expires));
        if self.waiting.len() >= self.purge_at {
            self.waiting.retain(|(request, _)| !request.is_abandoned());
            self.purge_at = PURGE_FROM.max(2 * self.waiting.len());
        }
    }

    fn expire(&mut self, link: &LinkState) {
        let now = Instant::now();
        while self.waiting.front().is_some_and(|(_, expires)| *expires <= now) {
            if let Some((request, _)) = self.waiting.pop_front() {
                request.fail(link.reason());
            }
        }
    }
}

impl DesiredSettings {
    fn record(&mut self, request: &Request) {
        match request {
            Request::Laser { on, .. } => self.laser = Some(*on),
            Request::BaudRate { baud_rate, .. } => {
                (self.baud_rate, self.attempts) = (Some(*baud_rate), 0);
            }
            _ => {}
        }
    }
}
