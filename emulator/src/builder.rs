//! [`EmulatorBuilder`]: the settings of an [`Emulator`], with their defaults.

use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::faults::{FaultInjector, Faults};
use super::handle::Emulator;
use super::journal::Journal;
use super::motor::Motor;
use super::playback::{Playback, ReplayPace, Script};
use super::scip::{Device, EmptyCommand, Firmware, Mode, RepeatedLaser};
use super::timed_device::TimedDevice;
use super::timing::{DeviceTiming, LONGEST, Pace};
use super::world::{Room, World};
use tokio_scip::BaudRate;

/// Builder of an [`Emulator`]. Each method documents its default.
#[must_use = "a builder does nothing until `build`"]
pub struct EmulatorBuilder {
    device: Device,
    is_intact: bool,
    timing: DeviceTiming,
    revolution: Duration,
    drift: f64,
    world: Option<Box<dyn World>>,
    playback: Option<Playback>,
    faults: Faults,
    seed: u64,
    log_capacity: usize,
}

impl fmt::Debug for EmulatorBuilder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EmulatorBuilder")
            .field("device", &self.device)
            .field("timing", &self.timing)
            .field("revolution", &self.revolution)
            .field("drift", &self.drift)
            .field("faults", &self.faults)
            .field("seed", &self.seed)
            .finish_non_exhaustive()
    }
}

impl Default for EmulatorBuilder {
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
            is_intact: false,
            timing: DeviceTiming {
                pace: Pace::default(),
                latency: Duration::ZERO,
                boot: Duration::ZERO,
                frame: Duration::ZERO,
                stray_byte: true,
                instant_line: false,
            },
            revolution: Duration::from_millis(100),
            drift: 0.0,
            world: None,
            playback: None,
            faults: Faults::none(),
            seed: 0,
            log_capacity: 32,
        }
    }
}

impl Emulator {
    /// Creates a builder with the default settings.
    pub fn builder() -> EmulatorBuilder {
        EmulatorBuilder::default()
    }
}

impl Default for Emulator {
    /// Powers up a sensor on USB with the default settings of [`EmulatorBuilder`].
    fn default() -> Self {
        Self::builder().build()
    }
}

impl EmulatorBuilder {
    /// Sets the firmware to play. Default: [`Firmware::V3`].
    pub fn firmware(mut self, firmware: Firmware) -> Self {
        self.device.firmware = firmware;
        self
    }

    /// Sets the serial number in the reply to `V`. Default: `H0713090`.
    pub fn serial_number(mut self, serial_number: impl Into<String>) -> Self {
        self.device.serial_number = serial_number.into();
        self
    }

    /// Sets the lines of the reply to `V`, without line feeds. They replace the lines of
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

    /// Puts the sensor on USB, where links say that every byte arrives as sent
    /// ([`delivers_intact`](tokio_scip::port::PortHints::delivers_intact)): the driver then computes
    /// stamps from the motor. Add no faults that change bytes.
    pub fn intact_usb(self) -> Self {
        Self { is_intact: true, ..self.usb() }
    }

    /// Puts the sensor on RS-232, at this baud rate until the first power cycle, and at
    /// 19,200 baud afterwards.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.device.baud_rate = Some(baud_rate);
        self
    }

    /// Sets whether the laser is on. Default: true, as after every power-up.
    pub fn laser(mut self, on: bool) -> Self {
        self.device.is_laser_on = on;
        self
    }

    /// Sets the status of the answer to `L` if the laser already is in that state.
    /// Default: [`RepeatedLaser::Status0`].
    pub fn repeated_laser(mut self, status: RepeatedLaser) -> Self {
        self.device.repeated_laser = status;
        self
    }

    /// Sets the protocol to speak until the next power cycle. Default: [`Mode::Scip1`].
    pub fn mode(mut self, mode: Mode) -> Self {
        self.device.mode = mode;
        self
    }

    /// Sets the answer to a terminator without a command. Default:
    /// [`EmptyCommand::Silence`].
    pub fn empty_command(mut self, answer: EmptyCommand) -> Self {
        self.device.empty_command = answer;
        self
    }

    /// Sets the number of excess points (or, negative, missing points) at the end of a
    /// scan, before clustering. Default: 0.
    pub fn miscount(mut self, points: i8) -> Self {
        self.device.miscount = points;
        self
    }

    /// Sets when the sensor answers. Default: [`Pace::PerRevolution`].
    pub fn pace(mut self, pace: Pace) -> Self {
        self.timing.pace = pace;
        self
    }

    /// Sets the duration of one revolution of the motor, at least 1 ms. Default: 100 ms.
    pub fn revolution(mut self, revolution: Duration) -> Self {
        self.revolution = revolution.clamp(Duration::from_millis(1), LONGEST);
        self
    }

    /// Sets how much longer or shorter a revolution becomes in an hour, as a fraction of
    /// at most 1 %. A real motor warms up. Default: zero.
    pub fn drift(mut self, an_hour: f64) -> Self {
        self.drift = an_hour;
        self
    }

    /// Lets replies begin only at multiples of this interval, as USB's frames of one millisecond
    /// do. Default: zero, a reply can begin at any time.
    pub fn frame(mut self, frame: Duration) -> Self {
        self.timing.frame = frame.min(LONGEST);
        self
    }

    /// Sets a delay of the first byte of each reply, in addition to the pace. Default:
    /// zero.
    pub fn latency(mut self, latency: Duration) -> Self {
        self.timing.latency = latency.min(LONGEST);
        self
    }

    /// Sets how long the sensor is silent after each power-up, including the first. A
    /// real sensor needs some seconds. Default: zero.
    pub fn boot_time(mut self, boot: Duration) -> Self {
        self.timing.boot = boot.min(LONGEST);
        self
    }

    /// Sets whether the sensor sends one byte 0x00 when its baud rate has changed.
    /// Default: true.
    pub fn stray_byte(mut self, stray_byte: bool) -> Self {
        self.timing.stray_byte = stray_byte;
        self
    }

    /// Sets the surroundings of the sensor. Default: a [`Room`] made from the seed.
    pub fn world(mut self, world: impl World + 'static) -> Self {
        self.world = Some(Box::new(world));
        self
    }

    /// Sets the faults. Default: no faults.
    pub fn faults(mut self, faults: Faults) -> Self {
        self.faults = faults;
        self
    }

    /// Sets the seed of the room, and of random faults without a seed. Default: 0.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets the number of command lines that [`Emulator::log`] keeps. Default: 32.
    pub fn log_capacity(mut self, commands: usize) -> Self {
        self.log_capacity = commands;
        self
    }

    /// Answers each `G` with the next reply of a script in place of a world. With
    /// [`ReplayPace::Max`], bytes take no time on the line.
    pub fn script(mut self, script: impl Script + 'static, pace: ReplayPace) -> Self {
        self.timing.pace = Pace::AtOnce;
        self.timing.instant_line = pace == ReplayPace::Max;
        self.playback = Some(Playback::new(Box::new(script), pace));
        self
    }

    /// Powers up the sensor.
    #[must_use]
    pub fn build(self) -> Emulator {
        let Self {
            device,
            is_intact,
            timing,
            revolution,
            drift,
            world,
            playback,
            faults,
            seed,
            log_capacity,
        } = self;
        let world = world.unwrap_or_else(|| Box::new(Room::new(seed)));
        let faults = FaultInjector::new(faults, seed);
        let journal = Journal::new(log_capacity);
        let now = Instant::now();
        let motor = Motor::new(revolution, drift, now);
        let mut sensor = TimedDevice::new(device, world, timing, motor, faults, journal, now);
        sensor.playback = playback;
        sensor.is_intact = is_intact;
        Emulator::new(sensor)
    }
}
