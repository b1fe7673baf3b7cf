//! Random settings of laser and baud rate, and windows, on links that come and go, to a sensor that
//! refuses them, says nothing or restarts. After each pause the sensor is as it was last set, the
//! state says what is so, and streams deliver or pause accordingly.
//!
//! `SCIP_SETTINGS=6000 cargo test --test it as_set` takes a minute; `SCIP_SETTINGS_FIRST=6000` draws
//! others.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::time::{Instant, sleep, timeout};
use tokio_scip::port::Connect;
use tokio_scip::{BaudRate, Error, ErrorKind, Operation, Rate, ScanStream, Sensor, State, Window};
use urg_emulator::{Emulator, Fault, Faults, Fixed, Link};

use crate::common::builder;
use crate::common::hooked::{Hooked, Hooks};
use crate::common::random::{Random, seeds};

/// Longest delay between two attempts at a laser that stays as it is, with its jitter.
const RETRY: Duration = Duration::from_secs(34);
/// Longest time until a link is back and its laser and baud rate are set.
const SETTLING: Duration = Duration::from_secs(12);

/// Kind of command that the sensor can refuse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    LaserOff,
    LaserOn,
    BaudRate,
    /// `G` with this cluster count.
    Cluster(u8),
}

const KINDS: [Kind; 4] = [Kind::LaserOff, Kind::LaserOn, Kind::BaudRate, Kind::Cluster(7)];

/// Which commands the sensor refuses or does not answer, and how many it received.
#[derive(Debug, Clone, Default)]
struct Refusals(Arc<Mutex<Refused>>);

#[derive(Debug, Default)]
struct Refused {
    faults: HashMap<Kind, Fault>,
    laser_on: u64,
}

/// Applies the refusals to each command that is written.
struct Refuse {
    emulator: Emulator,
    refusals: Refusals,
}

impl Hooks for Refuse {
    fn before_write(&mut self, bytes: &[u8]) {
        let line = bytes.trim_ascii();
        let kind = match line {
            [.., b'L', b'0'] => Kind::LaserOff,
            [.., b'L', b'1'] => Kind::LaserOn,
            [.., b'G', _, _, _, _, _, _, tens, ones] => {
                Kind::Cluster((tens - b'0') * 10 + ones - b'0')
            }
            _ if line.contains(&b'S') => Kind::BaudRate,
            _ => return,
        };
        let mut refused = self.refusals.0.lock().unwrap();
        refused.laser_on += u64::from(kind == Kind::LaserOn);
        let fault = refused.faults.get(&kind).cloned();
        self.emulator.set_faults(fault.map_or(Faults::none(), |fault| Faults::none().at(0, fault)));
    }
}

/// Opens the emulated sensor.
struct Opens(Emulator, Refusals);

impl Connect for Opens {
    type Port = Hooked<Link, Refuse>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let port = self.0.connect().await?;
        let hooks = Refuse { emulator: self.0.clone(), refusals: self.1.clone() };
        Ok(Hooked { port, hooks })
    }
}

/// Settings that may apply. Exactly one of each list does; `None` is no setting.
struct DesiredSettings {
    laser: Vec<Option<bool>>,
    baud_rate: Vec<Option<BaudRate>>,
    /// Baud rates that apply if the sensor refuses those set without a link.
    before: Vec<Option<BaudRate>>,
    /// True if the sensor may have refused a baud rate since the link was found.
    may_differ: bool,
}

struct History {
    seed: u64,
    random: Random,
    emulator: Emulator,
    refusals: Refusals,
    sensor: Sensor,
    is_plugged_in: bool,
    streams: Vec<ScanStream>,
    desired: DesiredSettings,
    /// When the sensor last began to accept a command that it had refused.
    accepts_since: Option<Instant>,
    steps: Vec<String>,
}

fn window(cluster: u8) -> Window {
    Window::new(300..=340).unwrap().with_cluster_count(cluster).unwrap()
}

impl History {
    async fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let baud_rate = (!random.once_in(3)).then(|| *random.pick(&BaudRate::ALL[..3]));
        let emulator = Emulator::builder().world(Fixed::filled(1000));
        let emulator = match baud_rate {
            Some(baud_rate) => emulator.baud_rate(baud_rate).build(),
            None => emulator.usb().build(),
        };
        let refusals = Refusals::default();
        let opens = Opens(emulator.clone(), refusals.clone());
        let sensor = builder();
        fastrand::seed(seed);
        let sensor =
            sensor.idle_probe(Some(Duration::from_secs(1))).request_timeout(Duration::from_secs(3));
        let baud_rate = random.once_in(2).then(|| *random.pick(&BaudRate::ALL));
        let sensor = match baud_rate {
            Some(baud_rate) => sensor.baud_rate(baud_rate),
            None => sensor,
        };
        let sensor = sensor.connect(opens).await.unwrap();
        let (laser, baud_rate) = (vec![None], vec![baud_rate]);
        let desired = DesiredSettings { laser, baud_rate, before: Vec::new(), may_differ: false };
        Self {
            seed,
            random,
            emulator,
            refusals,
            sensor,
            is_plugged_in: true,
            streams: Vec::new(),
            desired,
            accepts_since: None,
            steps: Vec::new(),
        }
    }

    fn fail(&self, what: &str) -> ! {
        let state = self.sensor.watch_state().get();
        panic!("seed {}: {what}; {state:?}, after {:#?}", self.seed, self.steps)
    }

    fn refuses(&self, kind: Kind) -> bool {
        self.refusals.0.lock().unwrap().faults.contains_key(&kind)
    }

    fn is_connected(&self) -> bool {
        matches!(self.sensor.watch_state().get(), State::Connected { .. })
    }

    async fn switch_laser(&mut self, on: bool) {
        let call =
            async { if on { self.sensor.laser_on().await } else { self.sensor.laser_off().await } };
        let limit = if self.random.once_in(4) { self.random.ms(900) } else { SETTLING };
        let outcome = timeout(limit, call).await;
        self.steps.push(format!("laser {on}: {outcome:?}"));
        match outcome {
            Err(_) if limit == SETTLING => self.fail("no answer"),
            // The driver may not have taken it.
            Err(_) => self.desired.laser.push(Some(on)),
            Ok(outcome) => {
                self.desired.laser = vec![Some(on)];
                if outcome.is_ok() && self.emulator.is_laser_on() != on {
                    self.fail("the laser is not as confirmed");
                }
            }
        }
    }

    async fn set_baud_rate(&mut self) {
        let baud_rate = *self.random.pick(&BaudRate::ALL);
        let limit = if self.random.once_in(6) { self.random.ms(900) } else { SETTLING };
        let outcome = timeout(limit, self.sensor.set_baud_rate(baud_rate)).await;
        self.steps.push(format!("{baud_rate} baud: {outcome:?}"));
        if self.emulator.baud_rate().is_none() {
            return;
        }
        match outcome {
            Err(_) if limit == SETTLING => self.fail("no answer"),
            Err(_) => self.desired.baud_rate.push(Some(baud_rate)),
            Ok(Ok(())) => {
                self.desired.baud_rate = vec![Some(baud_rate)];
                self.desired.before.clear();
                if self.emulator.baud_rate() != Some(baud_rate) {
                    self.fail("the baud rate is not as confirmed");
                }
            }
            Ok(Err(error)) if !is_about_baud_rate(&error) => {
                let before = std::mem::replace(&mut self.desired.baud_rate, vec![Some(baud_rate)]);
                self.desired.before.extend(before);
                self.doubt_baud_rate();
            }
            // Refused, and so forgotten.
            Ok(Err(_)) => {}
        }
    }

    /// Plugs the cable in, or pulls it.
    fn replug(&mut self) {
        let restarts = self.random.once_in(2);
        self.is_plugged_in = !self.is_plugged_in;
        self.steps.push(format!("plugged in: {}, restarts: {restarts}", self.is_plugged_in));
        match self.is_plugged_in {
            true => self.emulator.plug_in(),
            false => self.emulator.unplug(),
        }
        if restarts {
            self.emulator.power_cycle();
        }
    }

    fn refuse(&mut self) {
        let kind = *self.random.pick(&KINDS);
        let status = Fault::Status(*self.random.pick(b"1469E"));
        let fault = match (kind, self.random.below(4)) {
            (Kind::Cluster(_), _) | (_, 0 | 1) => status,
            (_, 2) => Fault::Lost,
            _ => Fault::CommandLost,
        };
        self.steps.push(format!("refused: {kind:?} {fault:?}"));
        self.refusals.0.lock().unwrap().faults.insert(kind, fault);
        self.doubt_baud_rate();
    }

    /// If the sensor refuses baud rates, it keeps its own, and the settings before apply.
    fn doubt_baud_rate(&mut self) {
        if self.refuses(Kind::BaudRate) {
            self.desired.may_differ = true;
            self.desired.baud_rate.append(&mut self.desired.before);
        }
    }

    async fn stream(&mut self) {
        if self.random.once_in(3) && !self.streams.is_empty() {
            let place = self.random.below(self.streams.len() as u64) as usize;
            self.steps.push(format!("dropped: {:?}", self.streams[place]));
            drop(self.streams.swap_remove(place));
            return;
        }
        let rate = *self.random.pick(&["10", "4", "1", "0.001"]);
        let window = window(*self.random.pick(&[1, 1, 2, 7]));
        self.steps.push(format!("stream: {window} at {rate} Hz"));
        let opened = self.sensor.scans(window, rate.parse::<Rate>().unwrap()).await;
        self.streams.push(opened.unwrap());
    }

    async fn settle(&mut self, is_cured: bool) {
        if !self.is_plugged_in {
            self.replug();
        }
        if is_cured {
            self.steps.push("cured".to_owned());
            self.refusals.0.lock().unwrap().faults.clear();
        }
        if is_cured {
            // Whenever it finds the sensor, the driver restores a baud rate that was refused.
            self.emulator.unplug();
            sleep(Duration::from_secs(1)).await;
            self.emulator.plug_in();
            self.desired.may_differ = false;
            sleep(RETRY).await;
        }
        sleep(SETTLING).await;
        self.steps.push("settled".to_owned());
        if !self.is_connected() {
            self.fail("there is no connection");
        }
        let State::Connected { baud_rate, streaming, .. } = self.sensor.watch_state().get() else {
            unreachable!("it is connected");
        };
        if baud_rate != self.emulator.baud_rate() {
            self.fail("the state has another baud rate than the sensor");
        }
        let mut allowed = self.desired.baud_rate.iter().map(|set| set.or(baud_rate));
        if baud_rate.is_some() && !self.desired.may_differ && !allowed.any(|set| set == baud_rate) {
            self.fail(&format!("the sensor is not as set: {:?}", self.desired.baud_rate));
        }
        let is_on = self.emulator.is_laser_on();
        let mut allowed = self.desired.laser.iter().map(|set| set.unwrap_or(is_on));
        let refused = if is_on { Kind::LaserOff } else { Kind::LaserOn };
        let is_tried = is_cured || self.accepts_since.is_none_or(|since| since.elapsed() > RETRY);
        if !allowed.any(|set| set == is_on) && !self.refuses(refused) && is_tried {
            self.fail("the laser is not as set");
        }
        let stale = self.sensor.freshness().check(Duration::ZERO).err();
        let reason = stale.and_then(|stale| stale.source);
        let is_paused = reason.is_some_and(|error| matches!(error.kind(), ErrorKind::LaserOff));
        if is_paused && is_on {
            self.fail("the laser is on, and said to be off");
        }
        if streaming != (!self.streams.is_empty() && !is_paused) {
            self.fail("`streaming` is wrong");
        }
        let since = Instant::now();
        sleep(Duration::from_secs(4)).await;
        for stream in &self.streams {
            if stream.rate().period() > Some(Duration::from_secs(2)) {
                continue;
            }
            let is_refused = self.refuses(Kind::Cluster(stream.window().cluster_count()));
            let delivers = stream.latest().is_some_and(|scan| scan.received_at() > since);
            if delivers != (is_on && !is_refused) {
                self.fail(&format!("laser on: {is_on}, but {stream:?} delivers: {delivers}"));
            }
        }
    }

    async fn step(&mut self) {
        match self.random.below(12) {
            0 | 1 => self.switch_laser(false).await,
            2 => self.switch_laser(true).await,
            3 => self.set_baud_rate().await,
            4 => self.replug(),
            5 => {
                self.steps.push("restart".to_owned());
                self.emulator.power_cycle();
            }
            6 => self.refuse(),
            7 => {
                let kind = *self.random.pick(&KINDS);
                self.steps.push(format!("accepted: {kind:?}"));
                if self.refusals.0.lock().unwrap().faults.remove(&kind).is_some() {
                    self.accepts_since = Some(Instant::now());
                }
            }
            8 | 9 => self.stream().await,
            10 => self.settle(false).await,
            _ => {
                let time = self.random.ms(4000);
                self.steps.push(format!("{time:?}"));
                sleep(time).await;
            }
        }
    }
}

/// Returns true if the sensor or its port refused a baud rate. Without a link, a request fails
/// with the reason of the latest attempt to open one, and its setting applies.
fn is_about_baud_rate(error: &Error) -> bool {
    match error.kind() {
        ErrorKind::UnsupportedBaudRate { .. } => true,
        ErrorKind::Timeout { operation, .. }
        | ErrorKind::Refused { operation, .. }
        | ErrorKind::Malformed { operation, .. }
        | ErrorKind::NotConfirmed { operation, .. } => *operation == Operation::SetBaudRate,
        _ => false,
    }
}

fn paused() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap()
}

#[test]
fn a_sensor_is_as_set_and_described() {
    for seed in seeds("SCIP_SETTINGS", 35) {
        paused().block_on(async {
            let mut history = History::new(seed).await;
            for _ in 0..12 {
                history.step().await;
            }
            history.settle(false).await;
            history.settle(true).await;
        });
    }
}

/// Checks the share of each stream beside refused ones, and what the refusals cost.
async fn beside_refused(seed: u64) {
    let mut random = Random::new(seed);
    let emulator = Emulator::builder().world(Fixed::filled(1000)).build();
    let refusals = Refusals::default();
    let opens = Opens(emulator.clone(), refusals.clone());
    let builder = builder();
    fastrand::seed(seed);
    let sensor = builder.connect(opens).await.unwrap();
    let (good, refused) = (1 + random.below(2), 1 + random.below(3));
    let mut streams = Vec::new();
    for number in 0..good + refused {
        let cluster = 2 + number as u8;
        if number >= good {
            let status = Fault::Status(*random.pick(b"1456E"));
            refusals.0.lock().unwrap().faults.insert(Kind::Cluster(cluster), status);
        }
        streams.push(sensor.scans(window(cluster), Rate::hz(10.0)).await.unwrap());
    }
    sleep(Duration::from_secs(120)).await;
    let share = 120 * 10 / (good + refused);
    for stream in &streams[..good as usize] {
        let scans = stream.latest().map_or(0, |scan| scan.sequence() + 1);
        assert!(scans * 10 > share * 9, "seed {seed}: {scans} scans, its share is {share}");
    }
    // It tries after 0, 1, 3, 7, 15, 31, 61 and 91 seconds.
    let (laser_on, fences) = (refusals.0.lock().unwrap().laser_on, sensor.stats().fences);
    assert!(laser_on <= 8 * refused, "seed {seed}: {laser_on} L1 for {refused} windows");
    assert!(fences <= 10 * refused, "seed {seed}: {fences} fences for {refused} windows");
}

#[test]
fn a_stream_keeps_its_share_beside_refused_ones() {
    for seed in seeds("SCIP_SETTINGS", 4) {
        paused().block_on(beside_refused(seed));
    }
}
