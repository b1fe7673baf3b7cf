//! [`Emulator`]: the handle to an emulated sensor.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::device::Mode;
use super::faults::{Fault, Faults};
use super::journal::{Counts, Received, SentScan};
use super::line_buffer::LineBuffer;
use super::link::{HostBaudRate, Link};
use super::shared::{Plugged, Shared};
use super::timed_device::TimedDevice;
use super::timing::LONGEST;
use tokio_scip::port::Connect;
use tokio_scip::{BaudRate, Error, ErrorKind};

/// Handle to an emulated sensor.
///
/// Clones are handles to the same sensor, which lives while a handle or a link exists. It runs
/// no task and no thread: each read, write or method call first brings it up to date. Without a
/// link it costs nothing.
///
/// Methods that are not `async` never wait, and work outside of a runtime, too.
#[derive(Debug, Clone)]
pub struct Emulator {
    shared: Arc<Shared>,
}

impl Emulator {
    pub(super) fn new(sensor: TimedDevice) -> Self {
        Self { shared: Arc::new(Shared::new(sensor)) }
    }

    /// Opens a link in memory. Hangs up a link that is already open: there is one cable.
    ///
    /// To a sensor on RS-232, the link is at 19,200 baud until you call
    /// [`Link::set_baud_rate`]. While the sensor is unplugged, the
    /// link is hung up from the start.
    pub fn link(&self) -> Link {
        self.open(match self.baud_rate() {
            Some(_) => HostBaudRate::Set(BaudRate::B19200),
            None => HostBaudRate::FollowsSensor,
        })
    }

    /// Opens a link like [`link`](Self::link), through a bridge whose baud rate the host cannot
    /// change.
    pub fn bridge(&self, baud_rate: BaudRate) -> Link {
        self.open(HostBaudRate::Fixed(baud_rate))
    }

    pub(super) fn open(&self, baud_rate: HostBaudRate) -> Link {
        let mut plugged = self.shared.lock();
        plugged.links += 1;
        let id = plugged.links;
        if plugged.plugged_in && !plugged.sensor.is_gone {
            plugged.set_host(baud_rate.bits_per_second());
            if plugged.sensor.device.body.model.is_on_ethernet() {
                // What was sent on another connection is lost, both ways.
                plugged.sensor.unplug(Instant::now());
                plugged.sensor.line = LineBuffer::default();
            }
            plugged.sensor.is_hung_up = false;
            plugged.link = Some(id);
        }
        Shared::wake_reader(plugged);
        self.shared.link_changed.notify_waiters();
        Link::new(Arc::clone(&self.shared), id, baud_rate)
    }

    /// Changes the sensor after everything that was due earlier, and wakes the reader.
    fn change(&self, change: impl FnOnce(&mut Plugged, Instant)) {
        let mut plugged = self.shared.lock_now();
        change(&mut plugged, Instant::now());
        Shared::wake_reader(plugged);
    }

    /// Pulls the cable. The open link is hung up, connecting fails with [`ErrorKind::NoSuchPort`],
    /// and bytes on their way are lost. The sensor keeps its power. If its cable powers it,
    /// also call [`power_cycle`](Self::power_cycle).
    pub fn unplug(&self) {
        self.change(|plugged, now| {
            plugged.plugged_in = false;
            plugged.link = None;
            plugged.sensor.unplug(now);
        });
        self.shared.link_changed.notify_waiters();
    }

    /// Plugs the cable in again. Links that were hung up stay so.
    pub fn plug_in(&self) {
        self.change(|plugged, now| {
            if !plugged.plugged_in {
                // Drops the bytes that the sensor has sent in between.
                plugged.sensor.unplug(now);
            }
            plugged.plugged_in = true;
        });
        self.shared.link_changed.notify_waiters();
    }

    /// Interrupts the power. A URG-04LX restarts at 19,200 baud, laser on, in SCIP 1.1; others
    /// restart in SCIP 2, laser off. The sensor is silent for the boot time. An open link stays open,
    /// except on Ethernet.
    pub fn power_cycle(&self) {
        self.change(|plugged, now| plugged.sensor.power_cycle(now));
    }

    /// Replaces the faults, starting with the next reply, which becomes number 0. Keeps the
    /// [counts](Self::fault_count) of faults.
    pub fn set_faults(&self, faults: Faults) {
        self.change(|plugged, _| plugged.sensor.set_faults(faults));
    }

    /// Changes the serial number in the reply to `V` and `VV`, as if you had replaced the sensor by
    /// another one.
    pub fn set_serial_number(&self, serial_number: impl Into<String>) {
        self.change(|plugged, _| plugged.sensor.device.body.serial_number = serial_number.into());
    }

    /// Changes the protocol that the sensor speaks. [`Mode::Scip2Streaming`] switches its laser on.
    pub fn set_mode(&self, mode: Mode) {
        self.change(|plugged, now| plugged.sensor.set_mode(mode, now));
    }

    /// Sends unsolicited bytes, after those on their way.
    pub fn inject(&self, bytes: impl Into<Vec<u8>>) {
        self.change(|plugged, now| plugged.sensor.send_unasked(now, bytes.into()));
    }

    /// Returns whether the laser is on.
    pub fn is_laser_on(&self) -> bool {
        self.shared.lock_now().sensor.device.body.is_laser_on
    }

    /// Baud rate of the sensor, or `None` on USB and Ethernet.
    pub fn baud_rate(&self) -> Option<BaudRate> {
        self.shared.lock_now().sensor.device.body.baud_rate
    }

    /// Returns true if a link is open and not hung up.
    pub fn is_connected(&self) -> bool {
        let plugged = self.shared.lock_now();
        plugged.link.is_some() && !plugged.sensor.is_hung_up
    }

    /// Counters of commands and replies.
    pub fn counts(&self) -> Counts {
        self.shared.lock_now().sensor.journal.counts
    }

    /// Number of faults injected so far of the same variant as `fault`, whatever its fields,
    /// both scripted and random. Includes those that changed nothing in their reply.
    pub fn fault_count(&self, fault: &Fault) -> u64 {
        self.shared.lock_now().sensor.faults.count(fault)
    }

    /// Latest command lines received, oldest first. Set their number with
    /// [`EmulatorBuilder::log_capacity`](super::EmulatorBuilder::log_capacity).
    pub fn log(&self) -> Vec<Received> {
        self.shared.lock_now().sensor.journal.log.iter().cloned().collect()
    }

    /// Latest scans sent, oldest first, with the true times of their revolutions. A
    /// [fence](tokio_scip::Stats::fences) is a scan, too. Set their number with
    /// [`EmulatorBuilder::log_capacity`](super::EmulatorBuilder::log_capacity).
    pub fn sent_scans(&self) -> Vec<SentScan> {
        self.shared.lock_now().sensor.journal.scans.iter().copied().collect()
    }

    /// Delays the motor once: from now on its revolutions end later by this time.
    pub fn delay_motor(&self, by: Duration) {
        self.change(|plugged, now| plugged.sensor.motor.delay(now, by.min(LONGEST)));
    }

    /// Changes the [drift](super::EmulatorBuilder::drift) of the motor, starting from its
    /// present period. A power cycle restores the drift at power-up.
    pub fn set_drift(&self, an_hour: f64) {
        self.change(|plugged, now| plugged.sensor.motor.set_drift(now, an_hour));
    }

    /// Moves the sensor's clock forward by this number of milliseconds, or back.
    pub fn jump_clock(&self, milliseconds: i64) {
        self.change(|plugged, _| plugged.sensor.clock.jump(milliseconds));
    }

    /// Changes how much faster the sensor's [clock](super::EmulatorBuilder::clock) runs than the
    /// host's.
    pub fn set_clock_rate(&self, faster: f64) {
        self.change(|plugged, now| plugged.sensor.clock.set_rate(now, faster));
    }

    #[cfg(all(unix, feature = "pty"))]
    pub(super) async fn wait_until_plugged_in(&self) {
        self.shared.wait_until(|plugged| plugged.plugged_in).await;
    }
}

/// Opens a new [`Link`] to the same sensor each time.
///
/// Fails with [`ErrorKind::NoSuchPort`] while the sensor is unplugged and with
/// [`ErrorKind::Busy`] while another link is open. Cancel-safe.
impl Connect for Emulator {
    type Port = Link;

    async fn connect(&mut self) -> Result<Link, Error> {
        let port = || "emulated".to_owned();
        let (is_there, is_busy) = {
            let plugged = self.shared.lock_now();
            (plugged.plugged_in && !plugged.sensor.is_gone, plugged.link.is_some())
        };
        match (is_there, is_busy) {
            (false, _) => Err(ErrorKind::NoSuchPort { port: port() }.into()),
            (true, true) => Err(ErrorKind::Busy { port: port() }.into()),
            (true, false) => Ok(self.link()),
        }
    }
}
