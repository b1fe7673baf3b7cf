//! [`Config`]: how a driver behaves, as the builder sets it.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use tokio::time::Instant;

use crate::BaudRate;
use crate::observer::ReplyObserver;
use crate::protocol::Text;

/// The settings of a driver.
#[derive(Debug, Clone)]
pub(crate) struct Config {
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
            observer: ReplyObserver::default(),
        }
    }
}
