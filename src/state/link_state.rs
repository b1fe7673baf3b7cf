//! [`LinkState`]: the [`State`], and the identity of the sensor while there is a link.

use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use tokio::sync::watch;
use tokio::time::Instant;

use super::link_log::LinkLog;
use super::{State, StateWatch, lock};
use crate::protocol::{Version, scip2};
use crate::{BaudRate, Error, ErrorChain, ErrorKind, Geometry};

/// A driver that waits for its sensor repeats each reason in the log after this time.
const WAITING_INTERVAL: Duration = Duration::from_secs(600);

#[derive(Debug)]
pub(crate) struct LinkState {
    name: Option<Arc<str>>,
    state: watch::Sender<State>,
    identity: Mutex<Option<(VersionReply, Geometry)>>,
    log: Mutex<LinkLog>,
}

/// Reply to `V` or `VV`, and to `PP`.
#[derive(Debug, Clone)]
pub(crate) struct VersionReply {
    pub(crate) version: Version,
    pub(crate) frame: Arc<KnownFrame>,
    /// Reply to `PP` in SCIP 2.
    pub(crate) parameters: Option<Arc<ParametersReply>>,
}

/// Reply to `PP`.
#[derive(Debug)]
pub(crate) struct ParametersReply {
    pub(crate) parameters: scip2::Parameters,
    pub(crate) frame: KnownFrame,
}

/// Reply as received.
#[derive(Debug)]
pub(crate) struct KnownFrame {
    /// Request in SCIP 2.
    pub(crate) request: Option<scip2::Request>,
    /// Bytes without the terminator.
    pub(crate) bytes: Box<[u8]>,
    pub(crate) received_at: Instant,
    /// Wall clock when the first byte arrived.
    pub(crate) stamp: SystemTime,
}

impl LinkState {
    pub(crate) fn new(name: Option<Arc<str>>) -> Self {
        let state = watch::Sender::new(State::Connecting { error: None });
        Self { name, state, identity: Mutex::default(), log: Mutex::default() }
    }

    /// Creates an error with the name of the sensor. Every error of a driver is made here.
    pub(crate) fn error(&self, kind: ErrorKind) -> Error {
        Error::new(kind, self.name.as_ref())
    }

    pub(crate) fn watch(&self) -> StateWatch {
        StateWatch { receiver: self.state.subscribe(), name: self.name.clone() }
    }

    /// Enters a state, and logs it, unless an attempt failed for the same reason as the one before.
    pub(super) fn enter(&self, state: State) {
        self.log(&state);
        if matches!(state, State::Disconnected { .. } | State::Closed { .. }) {
            *lock(&self.identity) = None;
        }
        // Only changes may wake watchers, and a user may hold a borrow.
        let is_news = !is_same(&self.state.borrow(), &state);
        if is_news {
            self.state.send_replace(state);
        }
    }

    fn log(&self, state: &State) {
        let mut link_log = lock(&self.log);
        match state {
            State::Connecting { error: Some(error) } => {
                if link_log.is_due(error, WAITING_INTERVAL) {
                    tracing::info!(error = %ErrorChain(error), "waiting for the sensor");
                }
            }
            State::Connecting { error: None } => tracing::debug!("searching for the sensor"),
            State::Connected { baud_rate, streaming, serial_number } => {
                let baud_rate = baud_rate.map(u32::from);
                match link_log.connect() {
                    true => tracing::info!(baud_rate, streaming, %serial_number, "connected"),
                    false => tracing::debug!(baud_rate, streaming, %serial_number, "connected"),
                }
            }
            State::Recovering => match link_log.lose() {
                true => {
                    let losses = link_log.losses();
                    tracing::warn!(losses, "the sensor does not answer: searching for it");
                }
                false => tracing::debug!("the sensor does not answer: searching for it"),
            },
            State::Disconnected { error, .. } => {
                let is_logged = link_log.lose();
                if link_log.is_due(error, Duration::MAX) {
                    let error = ErrorChain(error);
                    match is_logged {
                        true => {
                            tracing::warn!(%error, losses = link_log.losses(), "disconnected");
                        }
                        false => tracing::debug!(%error, "disconnected"),
                    }
                }
            }
            State::Closed { error: Some(error) } => {
                tracing::error!(error = %ErrorChain(error), "the driver has ended");
            }
            State::Closed { error: None } => tracing::debug!("closed"),
        }
    }

    /// Records a changed baud rate.
    pub(crate) fn set_baud_rate(&self, now: Option<BaudRate>) {
        self.state.send_if_modified(|state| match state {
            State::Connected { baud_rate, .. } => std::mem::replace(baud_rate, now) != now,
            _ => false,
        });
    }

    /// Records whether scans are polled. Wakes watchers only on a change.
    pub(crate) fn set_streaming(&self, now: bool) {
        self.state.send_if_modified(|state| match state {
            State::Connected { streaming, .. } => std::mem::replace(streaming, now) != now,
            _ => false,
        });
    }

    /// Error of calls after the driver has ended.
    pub(crate) fn cause(&self) -> Error {
        self.trouble().unwrap_or_else(|| self.error(ErrorKind::Closed))
    }

    /// Waits until the driver has ended, and returns the error of later calls.
    pub(crate) async fn closed(&self) -> Error {
        let is_closed = |state: &State| matches!(state, State::Closed { .. });
        // Fails only without a sender, and `self` owns it.
        let _ = self.state.subscribe().wait_for(is_closed).await.map(drop);
        self.cause()
    }

    pub(crate) fn is_closed(&self) -> bool {
        matches!(&*self.state.borrow(), State::Closed { .. })
    }

    /// Why there is no link, if an attempt has failed.
    pub(super) fn trouble(&self) -> Option<Error> {
        match &*self.state.borrow() {
            State::Connecting { error } => error.clone(),
            State::Disconnected { error, .. } => Some(error.clone()),
            State::Closed { error } => {
                Some(error.clone().unwrap_or_else(|| self.error(ErrorKind::Closed)))
            }
            State::Connected { .. } | State::Recovering => None,
        }
    }

    /// Why there is no link. While no attempt has failed yet, the sensor is silent.
    pub(crate) fn reason(&self) -> ErrorKind {
        let no_answer = ErrorKind::NoAnswer {
            baud_rate: None,
            searched: false,
            refused: Vec::new(),
            bytes: 0,
            words: None,
        };
        self.trouble().map_or(no_answer, |error| error.kind().clone())
    }

    /// Identity of the sensor, if there is a link.
    pub(crate) fn version_reply(&self) -> Option<VersionReply> {
        lock(&self.identity).as_ref().map(|(reply, _)| reply.clone())
    }

    /// Geometry of the sensor, if there is a link.
    pub(crate) fn geometry(&self) -> Option<Geometry> {
        lock(&self.identity).as_ref().map(|(_, geometry)| *geometry)
    }

    pub(crate) fn set_identity(&self, reply: VersionReply, geometry: Geometry) {
        *lock(&self.identity) = Some((reply, geometry));
    }
}

/// Returns true if there still is no link, for the same reason.
fn is_same(before: &State, now: &State) -> bool {
    let text = |error: &Error| ErrorChain(error).to_string();
    match (before, now) {
        (State::Connecting { error: before }, State::Connecting { error: now }) => {
            before.as_ref().map(text) == now.as_ref().map(text)
        }
        (
            State::Disconnected { since: before, error: last },
            State::Disconnected { since, error },
        ) => before == since && text(last) == text(error),
        (State::Recovering, State::Recovering) => true,
        _ => false,
    }
}
