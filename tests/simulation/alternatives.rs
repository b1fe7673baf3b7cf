//! The alternatives to a fence after a late reply: a small client for each, on the same
//! sensor and the same bad line as the driver. They use the crate's codec and checks of
//! replies, so that only the remedy differs.

use std::time::Duration;

use futures::{FutureExt, SinkExt, StreamExt};
use tokio::time::{Instant, timeout, timeout_at};
use tokio_scip::codec::{Frame, ScipCodec};
use tokio_scip::port::Connect;
use tokio_scip::protocol::{Command, Reply, ReplyError};
use tokio_scip::{Rate, Window};
use tokio_util::codec::Framed;
use urg_emulator::{Faults, Link};

use super::loss::{Loss, sensor};
use super::truth::{SimulationTruth, Timed};

/// Step that a client takes after a poll without a scan. Before each command all
/// clients drop the input that has arrived.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Remedy {
    /// No further step.
    Clear,
    /// Waits until nothing has arrived for this long.
    Quiet(Duration),
    /// Sends `V` until one is answered.
    Version,
}

/// Deadline of the driver for a `G` on USB.
const G_TIMEOUT: Duration = Duration::from_millis(500);
const V_TIMEOUT: Duration = Duration::from_secs(1);

struct FramedClient {
    framed: Framed<Link, ScipCodec>,
}

impl FramedClient {
    /// Drops the input that has arrived.
    fn clear(&mut self) {
        while self.framed.next().now_or_never().is_some() {}
        self.framed.read_buffer_mut().clear();
        *self.framed.codec_mut() = ScipCodec::default();
    }

    /// Returns the values of the reply to `command`, none for `V`, or `None` without a
    /// valid reply.
    async fn exchange(&mut self, command: Command, limit: Duration) -> Option<Vec<u32>> {
        self.clear();
        let deadline = Instant::now() + limit;
        self.framed.send(&command).await.unwrap();
        while let Ok(frame) = timeout_at(deadline, self.framed.next()).await {
            let Frame::Reply(frame) = frame.unwrap().unwrap() else { return None };
            match Reply::parse(&command, &frame) {
                Ok(reply) if reply.status.is_ok() => {
                    return Some(reply.values().iter().map(|value| u32::from(*value)).collect());
                }
                // A reply to another command.
                Err(ReplyError::Foreign { .. }) => {}
                _ => return None,
            }
        }
        None
    }

    async fn apply(&mut self, remedy: Remedy) {
        match remedy {
            Remedy::Clear => {}
            Remedy::Quiet(pause) => while timeout(pause, self.framed.next()).await.is_ok() {},
            Remedy::Version => while self.exchange(Command::Version, V_TIMEOUT).await.is_none() {},
        }
    }
}

/// Polls through a client with this remedy.
pub(crate) async fn poll(
    remedy: Remedy,
    window: Window,
    rate: Rate,
    faults: Faults,
    time: Duration,
) -> Loss {
    let truth = SimulationTruth::default();
    let mut emulator = sensor(&truth, rate).build();
    let link = Connect::connect(&mut emulator).await.unwrap();
    let mut client = FramedClient { framed: Framed::new(link, ScipCodec::default()) };
    emulator.set_faults(faults);
    let end = Instant::now() + time;
    let mut grid = rate.period().map(|period| {
        let mut grid = tokio::time::interval(period);
        grid.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        grid
    });
    let mut loss = Loss::default();
    while Instant::now() < end {
        if let Some(grid) = &mut grid {
            grid.tick().await;
        }
        let sent = Instant::now();
        loss.polls += 1;
        match client.exchange(Command::Distances(window), G_TIMEOUT).await {
            Some(values) => {
                let received = Instant::now();
                loss.add(&truth, &Timed { window, values, sent, received });
            }
            None => client.apply(remedy).await,
        }
    }
    loss
}
