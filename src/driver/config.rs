//! [`Config`]: how a driver behaves, as the builder sets it.

use std::sync::Arc;
use std::time::Duration;

use super::observers::ReplyObservers;
use crate::BaudRate;
use crate::protocol::{Protocol, Text};

/// Interval of probes on a link that can fail silently
/// ([`PortHints::can_die_silently`](crate::port::PortHints::can_die_silently)). With the deadlines
/// of the session, the driver notices a lost link within 10 s. A probe costs 26 bytes, in SCIP 2 60.
pub(crate) const PROBE_INTERVAL: Duration = Duration::from_secs(5);

/// Which idle links to probe, and how often.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum IdleProbe {
    /// Links that can fail silently, every [`PROBE_INTERVAL`].
    ByPort,
    /// All links, at this interval.
    Every(Duration),
    /// No link.
    Off,
}

impl IdleProbe {
    /// Probe interval of a link, or `None` for no probes.
    pub(crate) fn interval(self, can_die_silently: bool) -> Option<Duration> {
        match self {
            Self::ByPort => can_die_silently.then_some(PROBE_INTERVAL),
            Self::Every(interval) => Some(interval),
            Self::Off => None,
        }
    }
}

/// How to speak to a sensor, and what to ask it for.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Wanted {
    /// Protocol to speak, unless it is the sensor's choice.
    pub(crate) protocol: Option<Protocol>,
    /// True if scans should have intensities.
    pub(crate) intensities: bool,
}

#[derive(Debug, Clone)]
pub(crate) struct Config {
    /// Name of the sensor in logs and errors.
    pub(crate) name: Option<Arc<str>>,
    pub(crate) baud_rate: Option<BaudRate>,
    pub(crate) wanted: Wanted,
    pub(crate) open_timeout: Duration,
    pub(crate) request_timeout: Duration,
    pub(crate) wait_for_sensor: bool,
    pub(crate) reconnect: bool,
    pub(crate) backoff: (Duration, Duration),
    pub(crate) serial_number: Option<Text>,
    pub(crate) any_sensor: bool,
    pub(crate) depth: usize,
    pub(crate) reply_latency: Option<Duration>,
    pub(crate) idle_probe: IdleProbe,
    /// Observers that the builder has. The driver gets a copy.
    pub(crate) observers: Arc<ReplyObservers>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            name: None,
            baud_rate: None,
            wanted: Wanted::default(),
            open_timeout: Duration::from_secs(5),
            request_timeout: Duration::from_secs(5),
            wait_for_sensor: false,
            reconnect: true,
            backoff: (Duration::from_millis(100), Duration::from_secs(1)),
            serial_number: None,
            any_sensor: false,
            depth: 1,
            reply_latency: None,
            idle_probe: IdleProbe::ByPort,
            observers: Arc::default(),
        }
    }
}
