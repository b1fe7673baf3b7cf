//! What kind of sensor an [`Emulator`] is.

use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::Emulator;
use super::device::{Device, EmptyCommand, Firmware, Mode};
use super::faults::Faults;
use super::room::Room;
use super::script::Performance;
#[cfg(feature = "mcap")]
use super::script::Script;
use super::sensor::Sensor;
use super::timing::{Pace, Timing};
use super::world::World;
use crate::BaudRate;

/// Builds an [`Emulator`]. Each method says its default.
#[must_use = "a builder does nothing until `build`"]
pub struct Builder {
    device: Device,
    timing: Timing,
    world: Option<Box<dyn World>>,
    performance: Option<Performance>,
    faults: Faults,
    seed: u64,
    log: usize,
}

impl fmt::Debug for Builder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Builder")
            .field("device", &self.device)
            .field("timing", &self.timing)
            .field("faults", &self.faults)
            .field("seed", &self.seed)
            .finish_non_exhaustive()
    }
}

impl Default for Builder {
    fn default() -> Self {
        Self {
            device: Device {
                firmware: Firmware::default(),
                empty: EmptyCommand::default(),
                serial_number: "H0713090".to_owned(),
                version: None,
                miscount: 0,
                mode: Mode::default(),
                laser: true,
                speed: None,
            },
            timing: Timing {
                pace: Pace::default(),
                revolution: Duration::from_millis(100),
                latency: Duration::ZERO,
                boot: Duration::ZERO,
                stray_byte: true,
                instant_line: false,
            },
            world: None,
            performance: None,
            faults: Faults::none(),
            seed: 0,
            log: 32,
        }
    }
}

impl Builder {
    /// Which sensor is played: [`Firmware::V3`] unless set.
    pub fn firmware(mut self, firmware: Firmware) -> Self {
        self.device.firmware = firmware;
        self
    }

    /// The serial number that `V` tells: `H0713090` unless set.
    pub fn serial_number(mut self, serial_number: impl Into<String>) -> Self {
        self.device.serial_number = serial_number.into();
        self
    }

    /// Any lines at all as the reply to `V`, without line feeds, in place of
    /// those of the firmware and the serial number.
    pub fn version_lines<L: Into<Vec<u8>>>(mut self, lines: impl IntoIterator<Item = L>) -> Self {
        self.device.version = Some(lines.into_iter().map(Into::into).collect());
        self
    }

    /// The sensor is on USB, which has no baud rate: so it is unless set.
    pub fn usb(mut self) -> Self {
        self.device.speed = None;
        self
    }

    /// The sensor is on RS-232, and at this speed now. After a power cycle it
    /// is at 19,200 baud.
    pub fn baud_rate(mut self, speed: BaudRate) -> Self {
        self.device.speed = Some(speed);
        self
    }

    /// Whether the laser is on: it is unless set, as after every power-up.
    pub fn laser(mut self, on: bool) -> Self {
        self.device.laser = on;
        self
    }

    /// Which protocol it speaks until the next power cycle: [`Mode::Scip1`]
    /// unless set.
    pub fn mode(mut self, mode: Mode) -> Self {
        self.device.mode = mode;
        self
    }

    /// What it makes of a terminator without a command:
    /// [`EmptyCommand::Silence`] unless set.
    pub fn empty_command(mut self, empty: EmptyCommand) -> Self {
        self.device.empty = empty;
        self
    }

    /// How many points too many (or, negative, too few) it sends at the end of
    /// a scan, before clustering: 0 unless set.
    pub fn miscount(mut self, points: i8) -> Self {
        self.device.miscount = points;
        self
    }

    /// When it answers: [`Pace::PerRevolution`] unless set.
    pub fn pace(mut self, pace: Pace) -> Self {
        self.timing.pace = pace;
        self
    }

    /// How long one revolution of its motor takes: 100 ms unless set, at least
    /// 1 ms.
    pub fn revolution(mut self, revolution: Duration) -> Self {
        self.timing.revolution = revolution.max(Duration::from_millis(1));
        self
    }

    /// How much later than its pace says a reply begins: not at all unless set.
    pub fn latency(mut self, latency: Duration) -> Self {
        self.timing.latency = latency;
        self
    }

    /// How long it is silent after power-up, the first one included: not at all
    /// unless set; a real sensor takes some seconds.
    pub fn boot_time(mut self, boot: Duration) -> Self {
        self.timing.boot = boot;
        self
    }

    /// Whether one byte 0x00 comes when the baud rate has changed: it does
    /// unless set.
    pub fn stray_byte(mut self, stray_byte: bool) -> Self {
        self.timing.stray_byte = stray_byte;
        self
    }

    /// What it sees: a [`Room`] by the seed unless set.
    pub fn world(mut self, world: impl World + 'static) -> Self {
        self.world = Some(Box::new(world));
        self
    }

    /// What goes wrong: nothing unless set.
    pub fn faults(mut self, faults: Faults) -> Self {
        self.faults = faults;
        self
    }

    /// The seed of the room and of random faults that have none of their own:
    /// 0 unless set.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// How many of the last command lines [`Emulator::log`] keeps: 32 unless
    /// set.
    pub fn log_capacity(mut self, commands: usize) -> Self {
        self.log = commands;
        self
    }

    /// It plays a script, each reply when it is due or as fast as it is asked
    /// for, at once and without time on the line.
    #[cfg(feature = "mcap")]
    pub(crate) fn script(mut self, script: impl Script + 'static, paced: bool) -> Self {
        self.timing.pace = Pace::AtOnce;
        self.timing.instant_line = !paced;
        self.performance = Some(Performance::new(Box::new(script), paced));
        self
    }

    /// Powers the sensor up, now.
    #[must_use]
    pub fn build(self) -> Emulator {
        let Self { device, timing, world, performance, faults, seed, log } = self;
        let world = world.unwrap_or_else(|| Box::new(Room::new(seed)));
        let mut sensor = Sensor::new(device, world, timing, faults, seed, log, Instant::now());
        sensor.performance = performance;
        Emulator::new(sensor)
    }
}
