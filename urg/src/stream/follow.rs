//! Follows a stream until Ctrl-C, `--count`, `--duration`, or the end of the stream.

use tokio::time::Instant;

use super::feed::{Feed, Update};
use crate::args::PaceArgs;
use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Why [`follow`] stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StreamEnd {
    /// Reached `--count` or `--duration`.
    Complete,
    Interrupted,
    /// The stream itself ended, for example with its recording.
    ByItself,
}

/// Passes each update to `take` until the end, and those received before the end also after it. The
/// next scan stays in the feed.
pub(crate) async fn follow(
    feed: &mut Feed,
    pace: &PaceArgs,
    interrupt: &Interrupt,
    mut take: impl AsyncFnMut(Update) -> Result<(), Failure>,
) -> Result<StreamEnd, Failure> {
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
                feed.put_back(Update::Scan(scan));
                break;
            }
            Some(update) => {
                left -= u64::from(matches!(update, Update::Scan(_)));
                take(update).await?;
            }
            None => return Ok(StreamEnd::ByItself),
        }
    }
    Ok(ended.map_or(StreamEnd::Complete, |(ended, _)| ended))
}

/// Waits for a signal or for `--duration`. Returns the time of the earlier one.
async fn end(pace: &PaceArgs, interrupt: &Interrupt) -> (StreamEnd, Instant) {
    let begin = Instant::now();
    let complete = async {
        match pace.duration.and_then(|duration| begin.checked_add(duration)) {
            Some(end) => {
                tokio::time::sleep_until(end).await;
                end
            }
            // No duration, or one that overflows the clock.
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        at = complete => (StreamEnd::Complete, at),
        at = interrupt.requested() => (StreamEnd::Interrupted, at),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use futures_util::FutureExt;
    use tokio_scip::{Rate, Sensor, Window};
    use urg_emulator::Emulator;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn the_first_scan_after_the_end_stays_in_the_feed() {
        let sensor = Sensor::builder().connect(Emulator::default()).await.unwrap();
        let port = "emulated".parse().unwrap();
        let mut feed =
            Feed::open(&port, &sensor, Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        let (begin, duration) = (Instant::now(), Duration::from_millis(250));
        let pace = PaceArgs { rate: None, count: None, duration: Some(duration) };
        let interrupt = Interrupt::listen(false).unwrap();
        let mut taken = Vec::new();
        let write = async |update| {
            if let Update::Scan(scan) = update {
                taken.push(scan.sequence());
                tokio::time::sleep(2 * duration).await;
            }
            Ok(())
        };
        assert_eq!(follow(&mut feed, &pace, &interrupt, write).await.unwrap(), StreamEnd::Complete);
        let Some(Update::Scan(next)) = feed.next().now_or_never().flatten() else {
            panic!("no scan after {taken:?}")
        };
        assert!(next.received_at() > begin + duration);
        assert_eq!(taken, [0]);
    }
}
