//! [`EmulatorBuilder`]: the settings of an [`Emulator`], with their defaults.

use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

use super::body::Body;
use super::clock::Clock;
use super::device::{Device, Mode};
use super::faults::{FaultInjector, Faults};
use super::handle::Emulator;
use super::journal::Journal;
use super::models::Model;
use super::motor::Motor;
use super::playback::{Playback, ReplayPace, Script, Source};
use super::scip1::{Dialect, EmptyCommand, Firmware, RepeatedLaser};
use super::scip2::{Quirk, Session};
use super::timed_device::TimedDevice;
use super::timing::{DeviceTiming, LONGEST, Pace};
use super::world::{Room, World};
use tokio_scip::BaudRate;
use tokio_scip::protocol::scip2::Parameters;

/// Time of a byte at 100 Mbit/s.
const ETHERNET_BYTE: Duration = Duration::from_nanos(80);

/// Builder of an [`Emulator`]. Each method documents its default.
#[derive(Default)]
#[must_use = "a builder does nothing until `build`"]
pub struct EmulatorBuilder {
    body: Body,
    serial_number: Option<String>,
    dialect: Dialect,
    session: Session,
    mode: Mode,
    laser: Option<bool>,
    timing: DeviceTiming,
    pace: Option<Pace>,
    frame: Option<Duration>,
    revolution: Option<Duration>,
    drift: f64,
    clock: (Duration, f64),
    world: Option<Box<dyn World>>,
    playback: Option<Playback>,
    faults: Faults,
    seed: u64,
    log_capacity: Option<usize>,
}

impl fmt::Debug for EmulatorBuilder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EmulatorBuilder").field("body", &self.body).finish_non_exhaustive()
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
    /// Sets the model to play, which the other defaults depend on. Default: [`Model::Urg04lx`].
    pub fn model(mut self, model: Model) -> Self {
        self.body.model = model;
        self
    }

    /// Adds a [`Quirk`] to the quirks of the model. Default: none.
    pub fn quirk(mut self, quirk: Quirk) -> Self {
        self.session.quirks.push(quirk);
        self
    }

    /// Sets the firmware of a URG-04LX. Default: [`Firmware::V3`].
    pub fn firmware(mut self, firmware: Firmware) -> Self {
        self.dialect.firmware = firmware;
        self
    }

    /// Sets the serial number in the reply to `V` and `VV`. Default: `H0713090`.
    pub fn serial_number(mut self, serial_number: impl Into<String>) -> Self {
        self.serial_number = Some(serial_number.into());
        self
    }

    /// Sets the lines of the reply to `V` and `VV`, without line feeds and sums. They replace the lines of
    /// the firmware and the serial number.
    pub fn version_lines<L: Into<Vec<u8>>>(mut self, lines: impl IntoIterator<Item = L>) -> Self {
        self.body.version_lines = Some(lines.into_iter().map(Into::into).collect());
        self
    }

    /// Sets the reply to `PP`. Its first and last step limit the requests of SCIP 2. Default: that
    /// of the model.
    pub fn parameters(mut self, parameters: Parameters) -> Self {
        self.body.parameters = Some(parameters);
        self
    }

    /// Puts the sensor on USB, which has no baud rate. This is the default.
    pub fn usb(mut self) -> Self {
        self.body.baud_rate = None;
        self
    }

    /// Puts the sensor on USB, where links say that every byte arrives as sent
    /// ([`delivers_intact`](tokio_scip::port::PortHints::delivers_intact)): the driver then computes
    /// stamps from the motor. Add no faults that change bytes.
    pub fn intact_usb(mut self) -> Self {
        self.body.is_intact = true;
        self.usb()
    }

    /// Puts a URG-04LX on RS-232, at this baud rate until the first power cycle, and at
    /// 19,200 baud afterwards. Other models have no RS-232.
    pub fn baud_rate(mut self, baud_rate: BaudRate) -> Self {
        self.body.baud_rate = Some(baud_rate);
        self
    }

    /// Sets whether the laser is on. Default: as after every power-up, true in SCIP 1.1 and false
    /// in SCIP 2.
    pub fn laser(mut self, on: bool) -> Self {
        self.laser = Some(on);
        self
    }

    /// Sets the status of the answer to `L` if the laser already is in that state.
    /// Default: [`RepeatedLaser::Status0`].
    pub fn repeated_laser(mut self, status: RepeatedLaser) -> Self {
        self.dialect.repeated_laser = status;
        self
    }

    /// Sets the protocol to speak until the next power cycle. Default: [`Mode::Scip1`], which only a
    /// URG-04LX has: others speak SCIP 2.
    pub fn mode(mut self, mode: Mode) -> Self {
        self.mode = mode;
        self
    }

    /// Sets the answer to a terminator without a command. Default:
    /// [`EmptyCommand::Silence`].
    pub fn empty_command(mut self, answer: EmptyCommand) -> Self {
        self.dialect.empty_command = answer;
        self
    }

    /// Sets the number of excess points (or, negative, missing points) at the end of a
    /// scan, before clustering. Default: 0.
    pub fn miscount(mut self, points: i8) -> Self {
        self.body.miscount = points;
        self
    }

    /// Sets when the sensor answers. Default: [`Pace::PerRevolution`] of a URG, [`Pace::AtOnce`] of
    /// the others.
    pub fn pace(mut self, pace: Pace) -> Self {
        self.pace = Some(pace);
        self
    }

    /// Sets the duration of one revolution of the motor, at least 1 ms. Default: 100 ms of a URG,
    /// 25 ms of the others.
    pub fn revolution(mut self, revolution: Duration) -> Self {
        self.revolution = Some(revolution.clamp(Duration::from_millis(1), LONGEST));
        self
    }

    /// Sets how much longer or shorter a revolution becomes in an hour, as a fraction of
    /// at most 1 %. A real motor warms up. Default: zero.
    pub fn drift(mut self, an_hour: f64) -> Self {
        self.drift = an_hour;
        self
    }

    /// Sets what the sensor's clock, which SCIP 2 sends, reads now, and how much faster it runs than
    /// this host's, as a fraction: 0.002 for 0.2 %. At a power cycle it starts at zero. Default: zero
    /// and zero.
    pub fn clock(mut self, reads: Duration, faster: f64) -> Self {
        self.clock = (reads.min(LONGEST), faster);
        self
    }

    /// Lets replies begin only at multiples of this interval, as USB's frames of one millisecond
    /// do. Default: 1 ms of a UST; otherwise zero, a reply can begin at any time.
    pub fn frame(mut self, frame: Duration) -> Self {
        self.frame = Some(frame.min(LONGEST));
        self
    }

    /// Sets a delay of the first byte of each reply, in addition to the pace. Default: zero.
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

    /// Sets whether the sensor sends one byte 0x00 when its baud rate has changed. Default: true.
    pub fn stray_byte(mut self, stray_byte: bool) -> Self {
        self.timing.omits_stray_byte = !stray_byte;
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
        self.log_capacity = Some(commands);
        self
    }

    /// Sends the scans of a script in place of a world's. With [`ReplayPace::Max`], bytes take no time
    /// on the line.
    pub fn script(mut self, script: impl Script + 'static, pace: ReplayPace) -> Self {
        self.pace = Some(Pace::AtOnce);
        self.timing.byte_time = (pace == ReplayPace::Max).then_some(Duration::ZERO);
        self.playback = Some(Playback::new(Box::new(script), pace));
        self
    }

    /// Powers up the sensor.
    #[must_use]
    pub fn build(self) -> Emulator {
        let Self { mut body, dialect, session, mut timing, seed, .. } = self;
        let now = Instant::now();
        let model = body.model;
        let is_urg = matches!(model, Model::Urg04lx | Model::Urg04lxUg01);
        timing.pace = self.pace.unwrap_or(if is_urg { Pace::PerRevolution } else { Pace::AtOnce });
        if model.is_on_ethernet() {
            timing.frame = Duration::from_millis(1);
            timing.byte_time = timing.byte_time.or(Some(ETHERNET_BYTE));
        }
        timing.frame = self.frame.unwrap_or(timing.frame);
        body.serial_number = self.serial_number.unwrap_or_else(|| "H0713090".to_owned());
        body.baud_rate = body.baud_rate.filter(|_| model == Model::Urg04lx);
        let mut device = Device { body, dialect, session, is_in_scip2: false };
        device.set_mode(self.mode, now);
        let is_measuring = !device.is_in_scip2 || device.session.stream().is_some();
        device.body.is_laser_on = self.laser.unwrap_or(is_measuring);

        let world = self.world.unwrap_or_else(|| Box::new(Room::new(seed)));
        let source = Source { world, playback: self.playback };
        let faults = FaultInjector::new(self.faults, seed);
        let journal = Journal::new(self.log_capacity.unwrap_or(32));
        let revolution = self.revolution.unwrap_or(model.revolution());
        let motor = Motor::new(revolution, self.drift, now);
        let clock = Clock::new(now, self.clock.0, self.clock.1);
        let sensor = TimedDevice::new(device, source, timing, (motor, clock), faults, journal, now);
        Emulator::new(sensor)
    }
}
