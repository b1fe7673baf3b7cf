//! [`Builder`]: the settings of an [`Emulator`], with their defaults.

use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::faults::{FaultInjector, Faults};
use super::handle::Emulator;
use super::journal::Journal;
use super::playback::Playback;
#[cfg(feature = "mcap")]
use super::playback::{PlaybackPace, Script};
use super::scip::{Device, EmptyCommand, Firmware, Mode, RepeatedLaser};
use super::timed_device::TimedDevice;
use super::timing::{DeviceTiming, Pace};
use super::world::{Room, World};
use crate::BaudRate;

/// A builder of an [`Emulator`]. The default of each setting stands at its method.
#[must_use = "a builder does nothing until `build`"]
pub struct Builder {
    device: Device,
    timing: DeviceTiming,
    world: Option<Box<dyn World>>,
    playback: Option<Playback>,
    faults: Faults,
    seed: u64,
    log_capacity: usize,
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
                empty_command: EmptyCommand::default(),
                repeated_laser: RepeatedLaser::default(),
                serial_number: "H0713090".to_owned(),
                version_lines: None,
                miscount: 0,
                mode: Mode::default(),
                is_laser_on: true,
                baud_rate: None,
            },
            timing: DeviceTiming {
                pace: Pace::default(),
                revolution: Duration::from_millis(100),
                latency: Duration::ZERO,
                boot: Duration::ZERO,
                stray_byte: true,
                instant_line: false,
            },
            world: None,
            playback: None,
            faults: Faults::none(),
            seed: 0,
            log_capacity: 32,
        }
    }
}

impl Emulator {
    /// Returns a builder with the default settings.
    pub fn builder() -> Builder {
        Builder::default()
    }
}

impl Default for Emulator {
    /// Powers up a sensor on USB with the default settings of [`Builder`].
    fn default() -> Self {
        Self::builder().build()
    }
}

impl Builder {
    /// Sets the firmware to play: [`Firmware::V3`] unless set.
    pub fn firmware(mut self, firmware: Firmware) -> Self {
        self.device.firmware = firmware;
        self
    }

    /// Sets the serial number in the reply to `V`: `H0713090` unless set.
    pub fn serial_number(mut self, serial_number: impl Into<String>) -> Self {
        self.device.serial_number = serial_number.into();
        self
    }

    /// Sets the lines of the reply to `V`, without line feeds, in place of those of
    /// the firmware and the serial number.
    pub fn version_lines<L: Into<Vec<u8>>>(mut self, lines: impl IntoIterator<Item = L>) -> Self {
        self.device.version_lines = Some(lines.into_iter().map(Into::into).collect());
        self
    }

    /// Puts the sensor on USB, which has no baud rate. This is the default.
    pub fn usb(mut self) -> Self {
        self.device.baud_rate = None;
        self
    }

    /// Puts the sensor on RS-232, at this baud rate until the first power cycle;
    /// after one it is at 19,200 baud.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.device.baud_rate = Some(baud_rate);
        self
    }

    /// Sets whether the laser is on: true unless set, as after every power-up.
    pub fn laser(mut self, on: bool) -> Self {
        self.device.is_laser_on = on;
        self
    }

    /// Sets the status of the answer to `L` if the laser already is in that state:
    /// [`RepeatedLaser::Status2`] unless set.
    pub fn repeated_laser(mut self, status: RepeatedLaser) -> Self {
        self.device.repeated_laser = status;
        self
    }

    /// Sets the protocol that it speaks until the next power cycle: [`Mode::Scip1`]
    /// unless set.
    pub fn mode(mut self, mode: Mode) -> Self {
        self.device.mode = mode;
        self
    }

    /// Sets the answer to a terminator without a command: [`EmptyCommand::Silence`]
    /// unless set.
    pub fn empty_command(mut self, answer: EmptyCommand) -> Self {
        self.device.empty_command = answer;
        self
    }

    /// Sets the number of points too many (or, negative, too few) at the end of a
    /// scan, before clustering: 0 unless set.
    pub fn miscount(mut self, points: i8) -> Self {
        self.device.miscount = points;
        self
    }

    /// Sets the time at which it answers: [`Pace::PerRevolution`] unless set.
    pub fn pace(mut self, pace: Pace) -> Self {
        self.timing.pace = pace;
        self
    }

    /// Sets the duration of one revolution of its motor: 100 ms unless set, at least
    /// 1 ms.
    pub fn revolution(mut self, revolution: Duration) -> Self {
        self.timing.revolution = revolution.max(Duration::from_millis(1));
        self
    }

    /// Sets a delay of the first byte of each reply, after the time that the pace
    /// demands: zero unless set.
    pub fn latency(mut self, latency: Duration) -> Self {
        self.timing.latency = latency;
        self
    }

    /// Sets the time for which it is silent after power-up, the first one included:
    /// zero unless set; a real sensor needs some seconds.
    pub fn boot_time(mut self, boot: Duration) -> Self {
        self.timing.boot = boot;
        self
    }

    /// Sets whether it sends one byte 0x00 when its baud rate has changed: true
    /// unless set.
    pub fn stray_byte(mut self, stray_byte: bool) -> Self {
        self.timing.stray_byte = stray_byte;
        self
    }

    /// Sets its surroundings: a [`Room`] made from the seed unless set.
    pub fn world(mut self, world: impl World + 'static) -> Self {
        self.world = Some(Box::new(world));
        self
    }

    /// Sets the faults: none unless set.
    pub fn faults(mut self, faults: Faults) -> Self {
        self.faults = faults;
        self
    }

    /// Sets the seed of the room, and of random faults that have none of their own:
    /// 0 unless set.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets the number of command lines that [`Emulator::log`] keeps: 32 unless set.
    pub fn log_capacity(mut self, commands: usize) -> Self {
        self.log_capacity = commands;
        self
    }

    /// Plays a script in place of a world. With [`PlaybackPace::Immediate`] bytes take
    /// no time on the line.
    #[cfg(feature = "mcap")]
    pub(crate) fn script(mut self, script: impl Script + 'static, pace: PlaybackPace) -> Self {
        self.timing.pace = Pace::AtOnce;
        self.timing.instant_line = pace == PlaybackPace::Immediate;
        self.playback = Some(Playback::new(Box::new(script), pace));
        self
    }

    /// Powers up the sensor.
    #[must_use]
    pub fn build(self) -> Emulator {
        let Self { device, timing, world, playback, faults, seed, log_capacity } = self;
        let world = world.unwrap_or_else(|| Box::new(Room::new(seed)));
        let faults = FaultInjector::new(faults, seed);
        let journal = Journal::new(log_capacity);
        let mut sensor = TimedDevice::new(device, world, timing, faults, journal, Instant::now());
        sensor.playback = playback;
        Emulator::new(sensor)
    }
}
