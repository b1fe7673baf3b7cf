//! [`Hosts`]: the names under which the server answers.

use std::net::IpAddr;

/// Names that a request may use for this machine, besides addresses and `localhost`.
///
/// An attacker can make a name of their own resolve to this machine, and so read the page through
/// the browser of someone on the same network (DNS rebinding). An address cannot be redirected.
#[derive(Debug)]
pub(crate) struct Hosts(Vec<String>);

impl Hosts {
    /// Accepts the names of this machine, and others.
    pub(crate) fn new(others: impl IntoIterator<Item = String>) -> Self {
        let mut names: Vec<String> = others.into_iter().collect();
        if let Some(name) = machine_name() {
            let label = name.split('.').next().unwrap_or_default();
            names.extend([label.to_owned(), format!("{label}.local"), name]);
        }
        Self(names)
    }

    /// Judges a `Host` header. Any port passes, because a tunnel may use another port.
    pub(super) fn accept(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, _)) => address,
            None => host.split_once(':').map_or(host, |(name, _)| name),
        };
        let is_known = |known: &str| known.eq_ignore_ascii_case(name.trim_end_matches('.'));
        let is_named = is_known("localhost") || self.0.iter().any(|known| is_known(known));
        (is_named && !name.is_empty()) || name.parse::<IpAddr>().is_ok()
    }
}

#[cfg(unix)]
fn machine_name() -> Option<String> {
    Some(rustix::system::uname().nodename().to_str().ok()?.to_owned())
}

#[cfg(not(unix))]
fn machine_name() -> Option<String> {
    std::env::var("COMPUTERNAME").ok()
}
