//! [`Lookup`]: finds the addresses of a host, with one thread at most for each name.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;

use super::thread;

type LookupResult = Result<Vec<SocketAddr>, Arc<io::Error>>;
/// Has a value once the lookup has ended.
type Running = watch::Receiver<Option<LookupResult>>;

/// Lookups of this process, by host.
static RUNNING: Mutex<Vec<(String, Running)>> = Mutex::new(Vec::new());

/// Lookup of one host. The system's call blocks, and without a reachable server it can take
/// half a minute, longer than an attempt to connect may.
#[derive(Debug, Default)]
pub(super) struct Lookup {
    running: Option<Running>,
}

impl Lookup {
    /// Returns the addresses of the host. If you drop the future, the call continues on its
    /// thread, and the next one takes its result.
    pub(super) async fn addresses(&mut self, host: &str, port: u16) -> io::Result<Vec<SocketAddr>> {
        let name = host.to_owned();
        // The system's kind of this error has no stable name.
        let unknown = |error| io::Error::new(io::ErrorKind::NotFound, error);
        let resolve = move || Ok((name, 0).to_socket_addrs().map_err(unknown)?.collect());
        let mut found = self.run(host, resolve).await?;
        found.iter_mut().for_each(|address| address.set_port(port));
        Ok(found)
    }

    async fn run(
        &mut self,
        host: &str,
        resolve: impl FnOnce() -> io::Result<Vec<SocketAddr>> + Send + 'static,
    ) -> io::Result<Vec<SocketAddr>> {
        let running = self.running.get_or_insert_with(|| join(host, resolve));
        // Fails if the thread panicked or there is none.
        let outcome = running.wait_for(Option::is_some).await.map(|outcome| outcome.clone());
        self.running = None;
        let found = outcome.map_err(io::Error::other)?.unwrap_or_else(|| Ok(Vec::new()));
        found.map_err(|error| io::Error::new(error.kind(), error))
    }
}

/// Joins the running lookup of `host`, or starts one.
fn join(
    host: &str,
    resolve: impl FnOnce() -> io::Result<Vec<SocketAddr>> + Send + 'static,
) -> Running {
    let mut all = RUNNING.lock().unwrap_or_else(PoisonError::into_inner);
    // An error: its thread has ended.
    all.retain(|(_, running)| running.has_changed().is_ok());
    if let Some((_, running)) = all.iter().find(|(other, _)| other == host) {
        return running.clone();
    }
    let (outcome, running) = watch::channel(None);
    all.push((host.to_owned(), running.clone()));
    // Without a thread the sender is dropped, as if it had panicked.
    let _ = thread::run_on(move || outcome.send(Some(resolve().map_err(Arc::new))));
    running
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc;

    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn sensors_share_a_lookup_that_hangs() {
        let begun = Arc::new(AtomicUsize::new(0));
        let mut lookups: Vec<_> = (0..20).map(|_| Lookup::default()).collect();
        let mut ends = Vec::new();
        for attempt in 0..100 {
            let (begun, (end, ended)) = (Arc::clone(&begun), mpsc::channel::<()>());
            let resolve = move || {
                begun.fetch_add(1, Ordering::Relaxed);
                let _ = ended.recv();
                Ok(vec![([10, 0, 0, 1], 0).into()])
            };
            let attempt = lookups[attempt % 20].run("hangs", resolve);
            assert!(attempt.now_or_never().is_none());
            ends.push(end);
        }
        let mut other = Lookup::default();
        assert_eq!(other.addresses("127.0.0.1", 7).await.unwrap(), [([127, 0, 0, 1], 7).into()]);
        drop(ends);
        for lookup in &mut lookups {
            assert_eq!(lookup.run("hangs", || panic!("another lookup")).await.unwrap().len(), 1);
        }
        assert_eq!(begun.load(Ordering::Relaxed), 1);
        let missing = || Err(io::ErrorKind::NotFound.into());
        let error = other.run("fails", missing).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        // No name is this long, so no server is asked.
        let error = other.addresses(&"x".repeat(300), 7).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(other.run("panics", || panic!("a lookup")).await.is_err());
        assert!(other.addresses("127.0.0.1", 7).await.is_ok());
    }
}
