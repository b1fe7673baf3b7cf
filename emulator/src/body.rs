//! [`Body`]: what a sensor has in both protocols, and the [`Answer`] that it gives.

use tokio_scip::BaudRate;
use tokio_scip::protocol::Text;
use tokio_scip::protocol::scip2::Parameters;

use super::models::{Geometry, Model};

/// State of the sensor that commands of either protocol change.
#[derive(Debug, Clone, Default)]
pub(crate) struct Body {
    pub(crate) model: Model,
    pub(crate) serial_number: String,
    /// Lines of the reply to `V` or `VV`, in place of the firmware's.
    pub(crate) version_lines: Option<Vec<Vec<u8>>>,
    /// What `PP` says, in place of the model's own.
    pub(crate) parameters: Option<Parameters>,
    /// True if links on USB say that they deliver every byte as sent.
    pub(crate) is_intact: bool,
    /// Number of excess points at the end of a scan.
    pub(crate) miscount: i8,
    pub(crate) is_laser_on: bool,
    /// `None` on USB and on Ethernet.
    pub(crate) baud_rate: Option<BaudRate>,
}

/// Reply to a command, and what the command does beyond it.
#[derive(Debug, Default)]
pub(crate) struct Answer {
    pub(crate) bytes: Vec<u8>,
    pub(crate) effect: Effect,
}

/// Effect of a command beyond its reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Effect {
    #[default]
    None,
    /// Laser switched on, which takes a revolution.
    LaserOn,
    /// The reply comes this many microseconds later.
    Wait(u64),
    /// Baud rate that changes a revolution later.
    BaudRate(BaudRate),
    /// Speed of the motor: this many percent below the nominal one.
    MotorSpeed(u8),
    /// Distance data in the reply.
    Scan,
    /// Scans follow the reply.
    Stream,
    /// The clock restarts at zero; with `all`, speed and baud rate are those after power-up.
    Reset { all: bool },
    /// The sensor restarts after the reply.
    Reboot,
}

/// Fills in the distance of each step, and the intensity of each where there is place for it.
pub(crate) type Measure<'a> = &'a mut dyn FnMut(&mut [u32], &mut [u32]);

/// Steps that a command asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Steps {
    pub(crate) start: u16,
    pub(crate) end: u16,
    pub(crate) cluster: u16,
}

impl From<Vec<u8>> for Answer {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, effect: Effect::None }
    }
}

impl Body {
    /// Geometry in SCIP 1.1, or in SCIP 2.
    pub(crate) fn geometry(&self, in_scip2: bool) -> Geometry {
        let own = self.model.geometry(in_scip2);
        let told = self.parameters.as_ref().filter(|_| in_scip2);
        told.map_or(own, |told| own.with_parameters(told))
    }

    /// Lines of the reply to `PP`, if they are not the model's own.
    pub(crate) fn parameter_lines(&self) -> Option<Vec<Vec<u8>>> {
        let line = |(key, value): (Text, Text)| [key.as_bytes(), b":", value.as_bytes()].concat();
        Some(self.parameters.as_ref()?.pairs().map(line).collect())
    }

    /// Measures, and returns distance and intensity of each point asked for. A cluster has the
    /// point with the least `rank`.
    pub(crate) fn points<R: Ord>(
        &self,
        geometry: &Geometry,
        steps: Steps,
        has_intensity: bool,
        measure: Measure<'_>,
        rank: impl Fn(u32) -> R,
    ) -> Vec<(u32, u32)> {
        let outside = geometry.codes.outside;
        let mut distances = vec![outside; geometry.steps()];
        let mut intensities = vec![0; if has_intensity { geometry.steps() } else { 0 }];
        measure(&mut distances, &mut intensities);

        let first = usize::from(steps.start);
        let end = steps.end.saturating_add_signed(self.miscount.into());
        let points = (usize::from(end) + 1).saturating_sub(first);
        // A miscount may reach past the last step. Those points are not measurable.
        let intensities = intensities.into_iter().chain(std::iter::repeat(0));
        let all = distances.into_iter().chain(std::iter::repeat(outside)).zip(intensities);
        let window: Vec<_> = all.skip(first).take(points).collect();
        let groups = window.chunks(steps.cluster.max(1).into());
        groups
            .filter_map(|group| group.iter().copied().min_by_key(|(value, _)| rank(*value)))
            .collect()
    }
}
