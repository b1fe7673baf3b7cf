//! [`Lookup`]: finds the addresses of a host, with one thread at most.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};

use tokio::task::{JoinHandle, spawn_blocking};

/// Lookup of one host. The system's call blocks, and without a reachable server it can take
/// half a minute, longer than an attempt to connect may.
#[derive(Debug, Default)]
pub(super) struct Lookup {
    running: Option<JoinHandle<io::Result<Vec<SocketAddr>>>>,
}

impl Lookup {
    /// Returns the addresses of the host. If you drop the future, the call continues on its
    /// thread, and the next one takes its result.
    pub(super) async fn addresses(&mut self, host: &str, port: u16) -> io::Result<Vec<SocketAddr>> {
        let host = host.to_owned();
        self.run(move || Ok((host.as_str(), port).to_socket_addrs()?.collect())).await
    }

    async fn run(
        &mut self,
        resolve: impl FnOnce() -> io::Result<Vec<SocketAddr>> + Send + 'static,
    ) -> io::Result<Vec<SocketAddr>> {
        let outcome = self.running.get_or_insert_with(|| spawn_blocking(resolve)).await;
        self.running = None;
        outcome?
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, mpsc};

    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn attempts_share_a_lookup_that_hangs() {
        let begun = Arc::new(AtomicUsize::new(0));
        let mut lookup = Lookup::default();
        let mut attempt = || {
            let (begun, (end, ended)) = (Arc::clone(&begun), mpsc::channel::<()>());
            let resolve = move || {
                begun.fetch_add(1, Ordering::Relaxed);
                let _ = ended.recv();
                Ok(vec![([10, 0, 0, 1], 2000).into()])
            };
            assert!(lookup.run(resolve).now_or_never().is_none());
            end
        };
        let ends: Vec<_> = (0..20).map(|_| attempt()).collect();
        drop(ends);
        let found = lookup.run(|| panic!("a second lookup")).await.unwrap();
        assert_eq!((found.len(), begun.load(Ordering::Relaxed)), (1, 1));
        assert!(lookup.run(|| Err(io::ErrorKind::NotFound.into())).await.is_err());
    }
}
