//! [`Config`]: how a driver behaves, as the builder sets it.

use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::BaudRate;
use crate::observer::ReplyObserver;
use crate::protocol::Text;

/// The interval of probes on a link that may die silently
/// ([`Port::can_die_silently`](crate::Port::can_die_silently)). A lost link is noticed
/// after it and the deadlines of the fences that are then tried, within 10 s in all. A
/// probe costs 26 bytes on the wire.
pub(crate) const PROBE_INTERVAL: Duration = Duration::from_secs(5);

/// The idle links that are probed, and the interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum IdleProbe {
    /// Those that may die silently, every [`PROBE_INTERVAL`].
    ByPort,
    /// All of them, with this interval.
    Every(Duration),
    /// None.
    Off,
}

impl IdleProbe {
    /// Returns the interval for a link, `None` if it is not to be probed.
    pub(crate) fn interval(self, can_die_silently: bool) -> Option<Duration> {
        match self {
            Self::ByPort => can_die_silently.then_some(PROBE_INTERVAL),
            Self::Every(interval) => Some(interval),
            Self::Off => None,
        }
    }
}

/// The settings of a driver.
#[derive(Debug, Clone)]
pub(crate) struct Config {
    /// The name of the sensor in logs and errors.
    pub(crate) name: Option<Arc<str>>,
    pub(crate) baud_rate: Option<BaudRate>,
    pub(crate) open_timeout: Duration,
    pub(crate) wait_for_sensor: bool,
    pub(crate) reconnect: bool,
    pub(crate) backoff: (Duration, Duration),
    pub(crate) jitter_seed: Option<u64>,
    pub(crate) serial_number: Option<Text>,
    pub(crate) any_sensor: bool,
    pub(crate) ring_depth: usize,
    pub(crate) reply_latency: Option<Duration>,
    pub(crate) idle_probe: IdleProbe,
    pub(crate) observer: ReplyObserver,
}

impl Config {
    /// Returns the seed of everything that is random.
    pub(crate) fn seed(&self) -> u64 {
        let random = || RandomState::new().hash_one(Instant::now().into_std());
        self.jitter_seed.unwrap_or_else(random)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            name: None,
            baud_rate: None,
            open_timeout: Duration::from_secs(5),
            wait_for_sensor: false,
            reconnect: true,
            backoff: (Duration::from_millis(100), Duration::from_secs(1)),
            jitter_seed: None,
            serial_number: None,
            any_sensor: false,
            ring_depth: 1,
            reply_latency: None,
            idle_probe: IdleProbe::ByPort,
            observer: ReplyObserver::default(),
        }
    }
}
