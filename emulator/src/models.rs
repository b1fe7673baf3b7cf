//! [`Model`]: the sensors that the emulator plays, and the [`Geometry`] that each measures.

use std::ops::RangeInclusive;
use std::time::Duration;

use tokio_scip::protocol::scip2::Parameters;

/// Sensor model to play.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Model {
    /// URG-04LX, on USB or RS-232. After power-up it speaks SCIP 1.1 with its laser on.
    #[default]
    Urg04lx,
    /// URG-04LX-UG01, on USB: measures as the URG-04LX does, and speaks only SCIP 2.
    Urg04lxUg01,
    /// UTM-30LX, on USB: 1,081 steps, 40 scans a second, distances and intensities in SCIP 2.
    Utm30lx,
    /// UST-10LX, on Ethernet: measures as the UTM-30LX does. Knows times in microseconds.
    Ust10lx,
}

/// Directions and distances that a sensor measures, and its values that are no distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Geometry {
    /// Number of steps in a revolution.
    pub(crate) resolution: u16,
    /// Steps that the sensor measures.
    pub(crate) first: u16,
    pub(crate) last: u16,
    pub(crate) front: u16,
    /// Last step that can be asked for.
    pub(crate) end: u16,
    /// A revolution ends at this step. The sensor can then send its scan.
    pub(crate) turn: u16,
    /// Measurable distances in millimetres.
    pub(crate) nearest: u32,
    pub(crate) farthest: u32,
    /// Most surfaces return enough light up to this distance.
    reach: u32,
    pub(crate) codes: &'static Codes,
}

/// Values that are no distance.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Codes {
    /// Step outside of the window.
    pub(crate) outside: u32,
    /// Object that is too near.
    near: u32,
    /// Object beyond the range, up to each of these distances.
    far: &'static [(u32, u32)],
    /// Too little light, one of these.
    dark: &'static [u32],
    /// Point that two scans in a row did not measure.
    pub(crate) unstable: u32,
    /// Point next to a missing one.
    pub(crate) flickering: u32,
    /// Runs of missing points, each with the cumulative percentage of the runs.
    missing: &'static [(u8, u32)],
}

/// C-42-3320-A p. 7 and C-42-03320B p. 12. Runs are in the order of their frequency in captures of a
/// real URG-04LX.
const URG: Codes = Codes {
    outside: 19,
    near: 8,
    far: &[(5600, 16), (12_000, 6), (u32::MAX, 0)],
    dark: &[1, 2, 3, 4, 5],
    unstable: 9,
    flickering: 7,
    missing: &[(40, 0), (70, 6), (88, 16), (100, 7)],
};

/// C-42-03320B p. 12.
const UTM: Codes = Codes {
    outside: 5,
    near: 2,
    far: &[(u32::MAX, 1)],
    dark: &[1],
    unstable: 3,
    flickering: 5,
    missing: &[(100, 1)],
};

/// C-42-04213 p. 4.
const NOTHING: u32 = 65_533;
const ETHERNET: Codes = Codes {
    outside: NOTHING,
    near: 4,
    far: &[(u32::MAX, NOTHING)],
    dark: &[NOTHING],
    unstable: NOTHING,
    flickering: NOTHING,
    missing: &[(100, NOTHING)],
};

impl Model {
    /// Duration of a revolution at the nominal speed.
    pub(crate) const fn revolution(self) -> Duration {
        Duration::from_millis(match self {
            Self::Urg04lx | Self::Urg04lxUg01 => 100,
            Self::Utm30lx | Self::Ust10lx => 25,
        })
    }

    /// Number of bytes that a host can leave unread: of fast models as many as 2 s of scans.
    pub(crate) const fn buffered_bytes(self) -> usize {
        match self {
            Self::Urg04lx | Self::Urg04lxUg01 => 16 * 1024,
            Self::Utm30lx | Self::Ust10lx => 256 * 1024,
        }
    }

    pub(crate) const fn is_on_ethernet(self) -> bool {
        matches!(self, Self::Ust10lx)
    }

    /// Geometry in SCIP 1.1, or in SCIP 2, where distances have more bits.
    pub(crate) const fn geometry(self, in_scip2: bool) -> Geometry {
        let (codes, reach, nearest, farthest) = match self {
            Self::Urg04lx | Self::Urg04lxUg01 => {
                return Geometry {
                    resolution: 1024,
                    first: 44,
                    last: 725,
                    front: 384,
                    end: 768,
                    // The rear.
                    turn: 896,
                    nearest: 20,
                    farthest: if in_scip2 { 5600 } else { 4094 },
                    reach: 4094,
                    codes: &URG,
                };
            }
            Self::Utm30lx => (&UTM, 30_000, 23, 60_000),
            // As real ones say, of 2.23.0000 and 4.0.2-A; a UST-10LX is sold for 10 m.
            Self::Ust10lx => (&ETHERNET, 10_000, 20, 30_000),
        };
        Geometry {
            resolution: 1440,
            first: 0,
            last: 1080,
            front: 540,
            end: 1080,
            turn: 1081,
            nearest,
            farthest,
            reach,
            codes,
        }
    }
}

impl Geometry {
    /// Geometry that the reply to `PP` tells, with the codes of this one.
    pub(crate) fn with_parameters(self, told: &Parameters) -> Self {
        Self {
            resolution: told.steps_per_revolution,
            first: *told.steps.start(),
            last: *told.steps.end(),
            front: told.front,
            end: *told.steps.end(),
            // After the last step, but for a URG, whose revolution ends at its rear.
            turn: match self.turn == self.last + 1 {
                true => told.steps.end().saturating_add(1),
                false => self.turn,
            },
            nearest: *told.distances.start(),
            farthest: *told.distances.end(),
            ..self
        }
    }

    /// Number of steps that can be asked for.
    pub(crate) const fn steps(&self) -> usize {
        self.end as usize + 1
    }

    /// Steps that the sensor measures.
    pub(crate) fn window(&self) -> RangeInclusive<usize> {
        self.first.into()..=self.last.into()
    }

    /// Cosine and sine of one step. Constants, so that they are the same on every machine.
    pub(crate) const fn step(&self) -> (f64, f64) {
        match self.resolution {
            1024 => (0.999_981_175_282_601_1, 0.006_135_884_649_154_475),
            2880 => (0.999_997_620_177_351_8, 0.002_181_659_834_336_769_7),
            _ => (0.999_990_480_720_734_5, 0.004_363_309_284_746_571),
        }
    }

    /// Returns true if `value` is a distance.
    pub(crate) const fn is_distance(&self, value: u32) -> bool {
        value >= self.nearest && value != NOTHING
    }

    /// Converts a distance to a value: millimetres, or the code of its range.
    pub(crate) fn value(&self, distance: f64) -> u32 {
        match distance {
            d if d < f64::from(self.nearest) => self.codes.near,
            d if d > f64::from(self.farthest) => self.far(d),
            d => d as u32,
        }
    }

    /// Code of a surface that returns this fraction of the light, if the sensor does not see it;
    /// `noise` draws one of several.
    pub(crate) fn dark(&self, distance: f64, light: f64, noise: u64) -> Option<u32> {
        let reaches = distance / 1000.0 * (4094.0 / f64::from(self.reach));
        let codes = self.codes.dark;
        let code = codes.get((noise % codes.len() as u64) as usize).copied();
        code.filter(|_| light < 0.004 * reaches * reaches)
    }

    /// Code of a missing point, drawn by a fraction.
    pub(crate) fn missing(&self, drawn: f64) -> u32 {
        let code = self.codes.missing.iter().find(|(to, _)| drawn < f64::from(*to) / 100.0);
        code.map_or(self.codes.outside, |(_, code)| *code)
    }

    /// Code of a distance beyond the range.
    fn far(&self, distance: f64) -> u32 {
        let code = self.codes.far.iter().find(|(to, _)| distance <= f64::from(*to));
        code.map_or(self.codes.outside, |(_, code)| *code)
    }
}
