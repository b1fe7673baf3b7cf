//! The case that a seed selects: a sensor, a link to it, and its faults.

use std::time::Duration;

use tokio_scip::port::Connect;
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Error, Window};
use urg_emulator::{EmptyCommand, Emulator, Fault, Faults, Firmware, Link, Model, Pace};

use super::truth::SimulationTruth;
use crate::common::faulty_link::{Call, FaultyLink, LinkFailure};
use crate::common::random::Random;
use crate::common::ready_port::ReadyPort;

pub(crate) const SERIAL_NUMBER: &str = "H0713090";
const SCIP2_MODELS: [Model; 4] =
    [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];
/// Constant delay of each reply in SCIP 2, so that polls as fast as possible do not stop the clock.
pub(crate) const SCIP2_LATENCY: Duration = Duration::from_millis(1);

/// A sensor and its faults, as drawn from a seed.
pub(crate) struct Case {
    pub(crate) emulator: Emulator,
    pub(crate) protocol: Protocol,
    model: Model,
    /// `None` on USB and Ethernet.
    pub(crate) speed: Option<BaudRate>,
    pub(crate) boot: Duration,
    pub(crate) faults: Faults,
    /// Number of faults that can each change a value of a reply undetectably.
    pub(crate) flips: usize,
    /// True if commands are refused.
    pub(crate) refuses: bool,
    /// True if replies arrive twice.
    pub(crate) doubles: bool,
    /// True if the sensor's clock jumps: no stamp is compared then.
    pub(crate) jumps: bool,
    /// By how much a revolution is longer or shorter than the sensor tells.
    pub(crate) odd_by: Duration,
    /// True if commands may reach the sensor in part.
    pub(crate) torn: bool,
    /// True if the driver may have to send a command before a reply has ended.
    pub(crate) overlaps: bool,
    /// Time by which an effect of these faults outlasts them.
    pub(crate) lingers: Duration,
    pub(crate) events: CaseEvents,
    pub(crate) truth: SimulationTruth,
    pub(crate) script: LinkScript,
}

impl std::fmt::Debug for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { protocol, model, speed, boot, faults, events, script, .. } = self;
        write!(
            f,
            "{model:?} in {protocol}, {speed:?}, boots {boot:?}, {faults:?}, {events:?}, {script:?}"
        )
    }
}

fn is_fast(model: Model) -> bool {
    matches!(model, Model::Utm30lx | Model::Ust10lx)
}

/// Events besides faults of replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CaseEvents {
    pub(crate) unplug: bool,
    pub(crate) power_cycle: bool,
    pub(crate) other_sensor: bool,
    pub(crate) other_program: bool,
    pub(crate) unrequested_bytes: bool,
}

impl Case {
    pub(crate) fn draw(random: &mut Random) -> Self {
        let protocol = *random.pick(&[Protocol::Scip1, Protocol::Scip2]);
        let model = match protocol {
            Protocol::Scip2 => *random.pick(&SCIP2_MODELS),
            _ => Model::Urg04lx,
        };
        let speed = random.once_in(2).then(|| *random.pick(&BaudRate::ALL));
        let speed = speed.filter(|_| model == Model::Urg04lx);
        let boot = if random.once_in(3) { Duration::from_millis(1500) } else { Duration::ZERO };
        let truth = SimulationTruth::default();
        let builder = Emulator::builder().model(model).serial_number(SERIAL_NUMBER).boot_time(boot);
        let builder = match speed {
            Some(speed) => builder.baud_rate(speed),
            None => builder.usb(),
        };
        let told = Duration::from_millis(if is_fast(model) { 25 } else { 100 });
        let mut revolution = told;
        let empty = [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds];
        let builder = match protocol {
            Protocol::Scip2 => {
                let faster = (random.below(4001) as f64 - 2000.0) * 1e-6;
                let clock = random.ms(1 << 24);
                let odd = 870 + random.below(261);
                let per_mille = if random.once_in(3) { odd } else { 1000 };
                revolution = told * per_mille as u32 / 1000;
                let builder = builder.firmware(Firmware::V31).latency(SCIP2_LATENCY);
                builder.clock(clock, faster).revolution(revolution)
            }
            _ => builder
                .firmware(*random.pick(&[Firmware::Text, Firmware::V3]))
                .pace(*random.pick(&[Pace::AtOnce, Pace::PerRevolution]))
                .latency(Duration::from_millis(20) + random.ms(30)),
        };
        let emulator = builder
            .empty_command(*random.pick(&empty))
            .log_capacity(256)
            .stray_byte(random.once_in(2))
            .world(truth.world())
            .seed(random.next())
            .build();
        let mut case = Self {
            emulator,
            protocol,
            model,
            speed,
            boot,
            faults: Faults::none().seed(random.next()),
            flips: 0,
            refuses: false,
            doubles: false,
            jumps: false,
            odd_by: told.abs_diff(revolution),
            torn: false,
            overlaps: false,
            lingers: Duration::ZERO,
            events: CaseEvents {
                unplug: random.once_in(4),
                power_cycle: random.once_in(4),
                other_sensor: random.once_in(10),
                other_program: random.once_in(8),
                unrequested_bytes: random.once_in(8),
            },
            truth,
            script: LinkScript::draw(random),
        };
        if case.is_fast() {
            case.script.reads = case.script.reads.max(64);
        }
        case.events.unplug |= case.events.other_sensor;
        case.draw_faults(random);
        let CaseEvents { unplug, power_cycle, other_sensor, other_program, unrequested_bytes } =
            case.events;
        case.torn |= unplug || power_cycle || other_sensor || other_program || case.script.fails;
        case.overlaps |= case.torn || unrequested_bytes;
        case
    }

    /// Steps that the sensor measures, and that it can be asked for.
    pub(crate) fn widest(&self) -> Window {
        let steps = match (self.protocol, self.is_fast()) {
            (Protocol::Scip2, true) => 0..=1080,
            (Protocol::Scip2, false) => 44..=725,
            _ => 0..=768,
        };
        Window::new(steps).unwrap()
    }

    /// The window of the scans of a stream that asked for this one.
    pub(crate) fn window_of(&self, asked: Window) -> Window {
        let is_detection = (asked.start(), asked.end()) == (44, 725);
        match self.is_fast() && is_detection {
            true => self.widest().with_cluster_count(asked.cluster_count()).unwrap(),
            false => asked,
        }
    }

    /// Returns true if it sends 40 scans a second.
    fn is_fast(&self) -> bool {
        is_fast(self.model)
    }

    /// Upper bound of the bytes of a reply.
    fn longest_reply(&self) -> u32 {
        match self.protocol {
            // Three characters a step, and a sum and a line feed after each 64.
            Protocol::Scip2 => 64 + self.widest().steps() as u32 * 3 * 66 / 64,
            _ => 1600,
        }
    }

    fn draw_faults(&mut self, random: &mut Random) {
        let long = Duration::from_secs(3);
        // Only one of these: two together can shift points between them undetectably, or cancel
        // each other out in a sum.
        let place = random.below(1500) as usize;
        let is_scip2 = self.protocol == Protocol::Scip2;
        let flip = Fault::Flip(place, 1 << random.below(8));
        let mut damage = vec![
            Fault::Damaged,
            Fault::Drop(place..place + 1),
            Fault::Insert(place, vec![*random.pick(&b"\n\r\x000\xff"[..])]),
            Fault::Repeat(place..place + 65),
            Fault::Cut(place),
        ];
        if is_scip2 {
            damage.extend([flip.clone(), Fault::WrongSum]);
        }
        let mut faults = std::mem::take(&mut self.faults);
        for kind in 0..if is_scip2 { 20 } else { 18 } {
            if !random.once_in(5) || is_scip2 && kind == 7 {
                continue;
            }
            let rate = [0.001, 0.01, 0.05][random.below(3) as usize];
            faults = match kind {
                0 => faults.rate(2.0 * rate, Fault::CommandLost),
                1 => faults.rate(rate, Fault::Lost),
                2 => faults.rate(rate / 5.0, Fault::Status(*random.pick(b"1Ez"))),
                3 => faults.up_to(rate, Fault::Late(long)),
                4 => faults.up_to(rate, Fault::Pause(63, long)),
                5 => faults.rate(rate, Fault::Doubled),
                6 => {
                    let damage = random.pick(&damage).clone();
                    // A sum shows each flipped bit.
                    self.flips += usize::from(damage == Fault::Damaged && !is_scip2);
                    faults.rate(rate, damage)
                }
                7 => {
                    self.flips += 1;
                    faults.rate(rate, flip.clone())
                }
                8 => faults.rate(rate, Fault::Merged),
                9 => faults.rate(rate, Fault::Garbage(b"\0\0garbage\n".to_vec())),
                10 => faults.up_to(rate, Fault::Noise(2000)),
                11 => faults.rate(rate / 5.0, Fault::Trickle(Duration::from_millis(2))),
                12 => faults.rate(rate, Fault::CrLf),
                13 => faults.up_to(rate / 20.0, Fault::Reset(1599)),
                14 => faults.up_to(rate / 5.0, Fault::HangUp(1599)),
                15 => faults.rate(rate / 50.0, Fault::Endless(b"xyz\n\n".to_vec())),
                16 => {
                    // A second character in the status of a `G`, or of an `L`.
                    let place = *random.pick(&[10, 3]);
                    faults.rate(rate, Fault::Insert(place, b"0".to_vec()))
                }
                17 => faults.rate(rate, Fault::Pause(20, Duration::from_millis(450))),
                18 => faults.rate(rate, Fault::Ignored),
                _ => faults.up_to(rate / 20.0, Fault::ClockJump(long.as_millis() as i64)),
            };
            self.refuses |= kind == 2;
            self.doubles |= kind == 5;
            self.jumps |= kind == 19;
            self.overlaps |= kind > 2;
            self.torn |= matches!(kind, 13 | 14);
            self.lingers = self.lingers.max(match kind {
                3 | 4 => long,
                10 => Duration::from_millis(1100),
                11 => Duration::from_millis(2) * self.longest_reply(),
                13 => self.boot,
                _ => Duration::ZERO,
            });
        }
        self.faults = faults;
    }
}

/// Behaviour of the ports that are opened to the sensor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinkScript {
    reads: usize,
    writes: usize,
    pub(crate) fails: bool,
}

impl LinkScript {
    fn draw(random: &mut Random) -> Self {
        let sizes = [usize::MAX, usize::MAX, 1000, 64, 1];
        Self { reads: *random.pick(&sizes), writes: *random.pick(&sizes), fails: random.once_in(6) }
    }
}

/// Opens ports that behave as the script requires.
pub(crate) struct SimulatedConnect {
    pub(crate) emulator: Emulator,
    pub(crate) script: LinkScript,
    pub(crate) random: Random,
    /// True if its ports read without waiting, and stop their wake-ups.
    pub(crate) is_ready: bool,
    /// Shared with the case, which ends the failures.
    pub(crate) healthy: std::sync::Arc<std::sync::atomic::AtomicBool>,
}

impl Connect for SimulatedConnect {
    type Port = ReadyPort<FaultyLink<Link>>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let link = self.emulator.connect().await?;
        let LinkScript { reads, writes, fails } = self.script;
        let mut port = FaultyLink::new(link).short_reads(reads).partial_writes(writes);
        if fails && !self.healthy.load(std::sync::atomic::Ordering::Relaxed) {
            let call = *self.random.pick(&[Call::Read, Call::Write, Call::SetBaudRate]);
            // EIO, ENODEV, an end of input, and a call that never returns.
            let failures = [
                LinkFailure::Errno(5),
                LinkFailure::Errno(19),
                LinkFailure::End,
                LinkFailure::Stall,
            ];
            port = port.fail(call, 1 + self.random.below(300), *self.random.pick(&failures));
        }
        // Every other port behaves like a serial port of the system.
        Ok(if self.is_ready { ReadyPort::new(port) } else { ReadyPort::plain(port) })
    }
}
