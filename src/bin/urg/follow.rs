//! How long a stream is followed: until the user stops it, for a number of
//! scans, for a time, or to its own end.

use std::time::Instant;

use crate::args::PaceArgs;
use crate::failure::Failure;
use crate::feed::{Entry, Feed};
use crate::interrupt::Interrupt;

/// Why a stream is followed no further.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    /// There is as much of it as was asked for.
    AsAsked,
    /// There is no more of it.
    ByItself,
}

/// Hands on what comes, until the end: all that has come by then, also where
/// `take` is behind.
pub(crate) async fn follow(
    feed: &mut Feed,
    pace: &PaceArgs,
    interrupt: &Interrupt,
    mut take: impl AsyncFnMut(Entry) -> Result<(), Failure>,
) -> Result<Ended, Failure> {
    let end = end(pace, interrupt);
    tokio::pin!(end);
    let (mut ended, mut left) = (None, pace.count.unwrap_or(u64::MAX));
    while left > 0 {
        let entry = tokio::select! {
            biased;
            since = &mut end, if ended.is_none() => {
                ended = Some(since);
                continue;
            }
            entry = feed.next() => entry,
            () = std::future::ready(()), if ended.is_some() => break,
        };
        match entry {
            Some(Entry::Scan(scan)) if ended.is_some_and(|end| scan.received_at() > end) => break,
            Some(entry) => {
                left -= u64::from(matches!(entry, Entry::Scan(_)));
                take(entry).await?;
            }
            None => return Ok(Ended::ByItself),
        }
    }
    Ok(Ended::AsAsked)
}

/// Waits for the end that was asked for, and tells when it was.
async fn end(pace: &PaceArgs, interrupt: &Interrupt) -> Instant {
    let Some(duration) = pace.duration else { return interrupt.requested().await };
    let end = Instant::now() + duration;
    tokio::select! {
        () = tokio::time::sleep_until(end.into()) => end,
        since = interrupt.requested() => since,
    }
}
