//! [`wait_for_value`]: waits for a value that several parts of the program share.

use std::future::pending;

use tokio::sync::watch;

/// Waits until a watch has a value, forever if it never gets one.
pub(crate) async fn wait_for_value<T: Clone>(mut watch: watch::Receiver<Option<T>>) -> T {
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
