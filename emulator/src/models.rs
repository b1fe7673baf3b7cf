//! [`Model`]: the sensors that the emulator plays, and the [`Geometry`] that each measures.

use std::ops::RangeInclusive;
use std::time::Duration;

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
    /// Step at which a revolution ends, and its scan can be sent.
    pub(crate) turn: u16,
    /// Measurable distances in millimetres.
    pub(crate) nearest: u32,
    pub(crate) farthest: u32,
    /// Distance from which enough light returns of most surfaces.
    reach: u32,
    pub(crate) codes: Codes,
}

/// Values that are no distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Codes {
    /// 0 to 19 (C-42-3320-A p. 7, C-42-03320B p. 12).
    Urg,
    /// 1 to 5 (C-42-03320B p. 12).
    Utm,
    /// 65533, seen from real sensors.
    Ethernet,
}

impl Model {
    /// Duration of a revolution at the nominal speed.
    pub(crate) const fn revolution(self) -> Duration {
        Duration::from_millis(match self {
            Self::Urg04lx | Self::Urg04lxUg01 => 100,
            Self::Utm30lx | Self::Ust10lx => 25,
        })
    }

    /// Geometry in SCIP 1.1, or in SCIP 2, where distances have more bits.
    pub(crate) const fn geometry(self, in_scip2: bool) -> Geometry {
        let (codes, reach) = match self {
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
                    codes: Codes::Urg,
                };
            }
            Self::Utm30lx => (Codes::Utm, 30_000),
            Self::Ust10lx => (Codes::Ethernet, 10_000),
        };
        Geometry {
            resolution: 1440,
            first: 0,
            last: 1080,
            front: 540,
            end: 1080,
            turn: 1081,
            nearest: 23,
            farthest: 60_000,
            reach,
            codes,
        }
    }
}

impl Geometry {
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
        match self.codes {
            Codes::Urg => (0.999_981_175_282_601_1, 0.006_135_884_649_154_475),
            Codes::Utm | Codes::Ethernet => (0.999_990_480_720_734_5, 0.004_363_309_284_746_571),
        }
    }

    /// Returns true if `value` is a distance.
    pub(crate) const fn is_distance(&self, value: u32) -> bool {
        value >= self.nearest && value != NOTHING
    }

    /// Converts a distance to a value: millimetres, or the code of its range.
    pub(crate) fn value(&self, distance: f64) -> u32 {
        match distance {
            d if d < f64::from(self.nearest) => self.codes.near(),
            d if d > f64::from(self.farthest) => self.codes.far(d),
            d => d as u32,
        }
    }

    /// Returns true if the sensor does not see a surface in this distance, which returns this
    /// fraction of the light.
    pub(crate) fn is_dark(&self, distance: f64, light: f64) -> bool {
        let reaches = distance / 1000.0 * (4094.0 / f64::from(self.reach));
        light < 0.004 * reaches * reaches
    }

    /// Replaces each distance between two that are missing by error code 7, as a URG does.
    pub(crate) fn hide_lone_points(&self, values: &mut [u32]) {
        if self.codes != Codes::Urg {
            return;
        }
        let mut before = true;
        for step in self.window() {
            let after = values.get(step + 1).is_none_or(|&value| !self.is_distance(value));
            if let Some(value) = values.get_mut(step) {
                let is_distance = self.is_distance(*value);
                if is_distance && before && after {
                    *value = self.codes.flickering();
                }
                before = !is_distance;
            }
        }
    }
}

/// Code of a UST.
const NOTHING: u32 = 65_533;

impl Codes {
    /// Value of a step outside of the window.
    pub(crate) const fn outside(self) -> u32 {
        self.choose(19, 5)
    }

    /// Value where little light returned; `noise` draws one of several.
    pub(crate) const fn dark(self, noise: u64) -> u32 {
        self.choose(1 + (noise % 5) as u32, 1)
    }

    /// Value of a point that two scans in a row did not measure.
    pub(crate) const fn unstable(self) -> u32 {
        self.choose(9, 3)
    }

    /// Value of a point at the end of missing ones, or between two.
    pub(crate) const fn flickering(self) -> u32 {
        self.choose(7, 5)
    }

    /// Draws the value of a missing point by a fraction, 0 to 1.
    pub(crate) fn missing(self, drawn: f64) -> u32 {
        // In the order of their frequency in captures of a real URG-04LX, each with the cumulative
        // fraction of the runs.
        let codes = [(0, 0.40), (6, 0.70), (16, 0.88), (7, 1.0)];
        self.choose(codes.iter().find(|(_, up_to)| drawn < *up_to).map_or(0, |(code, _)| *code), 1)
    }

    /// Value of an object that is too near.
    const fn near(self) -> u32 {
        self.choose(8, 2)
    }

    /// Value of a distance beyond the range.
    fn far(self, distance: f64) -> u32 {
        let urg = match distance {
            d if d > 12_000.0 => 0,
            d if d > 5_600.0 => 6,
            _ => 16,
        };
        self.choose(urg, 1)
    }

    const fn choose(self, urg: u32, utm: u32) -> u32 {
        match self {
            Self::Urg => urg,
            Self::Utm => utm,
            Self::Ethernet => NOTHING,
        }
    }
}
