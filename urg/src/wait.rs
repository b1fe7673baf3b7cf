//! Waits that several parts of the program share.

use std::future::{pending, poll_fn};
use std::task::Poll;

use tokio::sync::watch;

/// Waits for the first future to complete. Returns its index and output.
pub(crate) async fn first<F: Future>(futures: impl Iterator<Item = F>) -> (usize, F::Output) {
    let mut futures: Vec<_> = futures.map(Box::pin).collect();
    poll_fn(|cx| {
        for (number, future) in futures.iter_mut().enumerate() {
            if let Poll::Ready(output) = future.as_mut().poll(cx) {
                return Poll::Ready((number, output));
            }
        }
        Poll::Pending
    })
    .await
}

/// Waits until a watch has a value, forever if it never gets one.
pub(crate) async fn some<T: Clone>(mut watch: watch::Receiver<Option<T>>) -> T {
    // Copied out: the future would not be `Send` with the guard held across an await.
    let value = match watch.wait_for(Option::is_some).await {
        Ok(value) => value.clone(),
        Err(_) => None,
    };
    match value {
        Some(value) => value,
        None => pending().await,
    }
}
