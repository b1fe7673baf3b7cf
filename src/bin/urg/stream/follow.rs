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
    /// The requested number of scans or time is reached.
    Complete,
    /// The user stopped it.
    Interrupted,
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
            end = &mut end, if ended.is_none() => {
                ended = Some(end);
                continue;
            }
            update = feed.next() => update,
            () = std::future::ready(()), if ended.is_some() => break,
        };
        match update {
            Some(Update::Scan(scan)) if ended.is_some_and(|(_, at)| scan.received_at() > at) => {
                break;
            }
            Some(update) => {
                left -= u64::from(matches!(update, Update::Scan(_)));
                take(update).await?;
            }
            None => return Ok(Ended::ByItself),
        }
    }
    Ok(ended.map_or(Ended::Complete, |(ended, _)| ended))
}

/// Waits for the requested end, and returns its time.
async fn end(pace: &PaceArgs, interrupt: &Interrupt) -> (Ended, Instant) {
    let begin = Instant::now();
    let complete = async {
        match pace.duration.and_then(|duration| begin.checked_add(duration)) {
            Some(end) => {
                tokio::time::sleep_until(end).await;
                end
            }
            // Without a duration, or with one longer than any clock.
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        at = complete => (Ended::Complete, at),
        at = interrupt.requested() => (Ended::Interrupted, at),
    }
}
