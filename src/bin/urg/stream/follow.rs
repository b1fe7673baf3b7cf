//! Follows a stream: until the user stops it, for a number of scans, for a time,
//! or to its own end.

use tokio::time::Instant;

use super::feed::{Feed, Update};
use crate::args::PaceArgs;
use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// The reason why a stream is followed no further.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    /// The requested number or time is reached, or the user stopped it.
    AsAsked,
    /// The stream has ended.
    ByItself,
}

/// Passes each update to `take` until the end: every one that had come by then,
/// also if `take` is behind.
pub(crate) async fn follow(
    feed: &mut Feed,
    pace: &PaceArgs,
    interrupt: &Interrupt,
    mut take: impl AsyncFnMut(Update) -> Result<(), Failure>,
) -> Result<Ended, Failure> {
    let end = end(pace, interrupt);
    tokio::pin!(end);
    let (mut ended, mut left) = (None, pace.count.unwrap_or(u64::MAX));
    while left > 0 {
        let update = tokio::select! {
            biased;
            since = &mut end, if ended.is_none() => {
                ended = Some(since);
                continue;
            }
            update = feed.next() => update,
            () = std::future::ready(()), if ended.is_some() => break,
        };
        match update {
            Some(Update::Scan(scan)) if ended.is_some_and(|end| scan.received_at() > end) => break,
            Some(update) => {
                left -= u64::from(matches!(update, Update::Scan(_)));
                take(update).await?;
            }
            None => return Ok(Ended::ByItself),
        }
    }
    Ok(Ended::AsAsked)
}

/// Waits for the requested end, and returns its time.
async fn end(pace: &PaceArgs, interrupt: &Interrupt) -> Instant {
    let Some(duration) = pace.duration else { return interrupt.requested().await };
    let end = Instant::now() + duration;
    tokio::select! {
        () = tokio::time::sleep_until(end) => end,
        since = interrupt.requested() => since,
    }
}
