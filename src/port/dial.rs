//! Connects to the first address of a host that accepts (RFC 8305, "Happy Eyeballs"). Attempts start
//! one after another without waiting for earlier ones to fail. So an address that never answers
//! costs a fraction of a second instead of the whole time limit.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::task::JoinSet;
use tokio::time::sleep;

/// Delay before the next address is tried in parallel (RFC 8305, section 5).
const ATTEMPT_DELAY: Duration = Duration::from_millis(250);

/// Connects to each of the addresses with `connect` until one attempt succeeds, and drops the others.
///
/// Has no time limit: waits for an address that neither accepts nor refuses if no other
/// accepts. Cancel-safe: dropping the future drops all attempts.
///
/// # Errors
///
/// Fails after every attempt has failed, with the error of the only address, or with one
/// that lists all addresses and their errors.
pub(super) async fn connect_first<T, F>(
    mut untried: Vec<SocketAddr>,
    connect: impl Fn(SocketAddr) -> F,
) -> io::Result<T>
where
    T: Send + 'static,
    F: Future<Output = io::Result<T>> + Send + 'static,
{
    let mut attempts = JoinSet::new();
    let mut failures = Vec::new();
    let mut is_latest_ipv6 = None;
    loop {
        if !untried.is_empty() {
            // The families alternate (RFC 8305, section 4): one whole family may be unreachable.
            let other = untried.iter().position(|next| Some(next.is_ipv4()) == is_latest_ipv6);
            let address = untried.remove(other.unwrap_or(0));
            is_latest_ipv6 = Some(address.is_ipv6());
            let attempt = connect(address);
            attempts.spawn(async move { attempt.await.map_err(|error| (address, error)) });
        }
        tokio::select! {
            biased;
            ended = attempts.join_next() => match ended.transpose()? {
                Some(Ok(connection)) => return Ok(connection),
                Some(Err(failure)) => failures.push(failure),
                None => return Err(all_failed(failures)),
            },
            () = sleep(ATTEMPT_DELAY), if !untried.is_empty() => {}
        }
    }
}

fn all_failed(mut failures: Vec<(SocketAddr, io::Error)>) -> io::Error {
    let Some((_, last)) = failures.last() else {
        return io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    };
    let kind = last.kind();
    if failures.len() == 1
        && let Some((_, only)) = failures.pop()
    {
        return only;
    }
    let list: Vec<_> =
        failures.iter().map(|(address, error)| format!("{address}: {error}")).collect();
    io::Error::new(kind, list.join("; "))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use tokio::time::Instant;

    use super::*;

    const HANGS: u16 = 1;
    const REFUSES: u16 = 2;
    const ACCEPTS: u16 = 3;

    /// Behaves as the TCP port of the address selects.
    async fn fake(address: SocketAddr) -> io::Result<SocketAddr> {
        match address.port() % 10 {
            HANGS => std::future::pending().await,
            REFUSES => return Err(io::ErrorKind::ConnectionRefused.into()),
            _ => {}
        }
        Ok(address)
    }

    fn v4(port: u16) -> SocketAddr {
        ([10, 0, 0, 1], port).into()
    }

    fn v6(port: u16) -> SocketAddr {
        ([0xfd00, 0, 0, 0, 0, 0, 0, 1], port).into()
    }

    #[tokio::test(start_paused = true)]
    async fn o24_a_dead_address_costs_a_quarter_second_and_a_refusal_nothing() {
        let start = Instant::now();
        let addresses = vec![v6(HANGS), v4(REFUSES), v6(REFUSES), v4(HANGS), v4(ACCEPTS)];
        assert_eq!(connect_first(addresses, fake).await.unwrap(), v4(ACCEPTS));
        assert_eq!(start.elapsed(), 2 * ATTEMPT_DELAY);
    }

    #[tokio::test(start_paused = true)]
    async fn if_all_fail_the_error_lists_them_in_order() {
        let error = connect_first(vec![v4(2), v4(12), v4(22), v6(2)], fake).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::ConnectionRefused);
        let order = ["10.0.0.1:2", "[fd00::1]:2", "10.0.0.1:12", "10.0.0.1:22"];
        let expected = order.map(|address| format!("{address}: connection refused"));
        assert_eq!(error.to_string(), expected.join("; "), "the families alternate");
        let error = connect_first(Vec::new(), fake).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
    }
}
