//! A service, a sensor and a line, run once for each sequence of choices.

use std::cell::Cell;
use std::fmt;
use std::time::Duration;

use tokio::runtime::Runtime;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::protocol::Protocol;
use tokio_scip::{BaudRate, Error, Rate, ScanStream, Sensor, Window};

use super::chooser::Chooser;
use super::fate::Fate;
use super::line::{Cut, Depth, ModelLine};
use super::sensor::ModelSensor;

/// A run that takes longer hangs.
const LIMIT: Duration = Duration::from_secs(120);
/// Scans that each stream has to bring after the last choice.
const SCANS_AFTER: usize = 2;
/// Time for which the laser is off.
const STAYS_OFF: Duration = Duration::from_millis(250);
const OTHER_WINDOW: std::ops::RangeInclusive<u16> = 500..=501;
const OTHER_BAUD_RATE: BaudRate = BaudRate::B115200;

/// Fates, user actions and windows to enumerate.
pub(crate) struct Scenario {
    pub(crate) name: &'static str,
    /// Protocol after power-up, and the one to speak.
    pub(crate) protocols: (Protocol, Protocol),
    /// Windows and rates of the streams.
    pub(crate) streams: Vec<(Window, Rate)>,
    /// False on USB.
    pub(crate) has_baud_rate: bool,
    pub(crate) fates: &'static [Fate],
    /// Actions besides, each in every place.
    pub(crate) deeds: &'static [Deed],
    /// True if the choices begin with opening, false if they begin with the streams.
    pub(crate) chooses_while_opening: bool,
    /// Command of another program, which has died.
    pub(crate) left_over: Option<&'static [u8]>,
}

/// An action of a user, or with the cable, done once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Deed {
    Scan,
    /// A scan whose future is dropped at the next place.
    CancelledScan,
    /// Another stream is opened, and dropped after a scan.
    Stream,
    /// Laser is switched off and on.
    Laser,
    BaudRate,
    Cut(Cut),
}

/// Figures of an enumeration.
#[derive(Debug, Default)]
pub(crate) struct SearchFigures {
    runs: u64,
    scans: u64,
    pub(crate) slowest: Duration,
}

impl SearchFigures {
    pub(crate) fn add(&mut self, other: &Self) {
        self.runs += other.runs;
        self.scans += other.scans;
        self.slowest = self.slowest.max(other.slowest);
    }
}

impl fmt::Display for SearchFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { runs, scans, slowest } = self;
        write!(f, "{runs} sequences, {scans} scans, the longest run {slowest:?}")
    }
}

impl Scenario {
    /// Runs every sequence of choices. Panics with a drawing of the first one that breaks
    /// a promise.
    pub(crate) fn explore(&self, depth: Depth, deed: Option<(Deed, usize)>) -> SearchFigures {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let runtime = builder.enable_time().start_paused(true).build().unwrap();
        let (mut figures, mut chooser) = (SearchFigures::default(), Chooser::default());
        loop {
            let (ran, outcome, _) = self.run(&runtime, chooser, depth, deed, false);
            chooser = ran;
            match outcome {
                Ok(run) => figures.add(&run),
                Err(reason) => self.fail(&runtime, &chooser.choices(), depth, deed, &reason),
            }
            if !chooser.advance() {
                return figures;
            }
        }
    }

    /// Runs a sequence again to draw it.
    fn fail(
        &self,
        runtime: &Runtime,
        choices: &[usize],
        depth: Depth,
        deed: Option<(Deed, usize)>,
        reason: &str,
    ) -> ! {
        let chooser = Chooser::starting_with(choices);
        let (_, _, drawing) = self.run(runtime, chooser, depth, deed, true);
        panic!("{}, {deed:?}, choices {choices:?}: {reason}\n\n{drawing}\n", self.name);
    }

    /// Runs one sequence. Returns the chooser, the outcome, and a drawing if one is wanted.
    fn run(
        &self,
        runtime: &Runtime,
        chooser: Chooser,
        depth: Depth,
        deed: Option<(Deed, usize)>,
        draws: bool,
    ) -> (Chooser, Result<SearchFigures, String>, String) {
        runtime.block_on(async {
            let mut sensor = ModelSensor::new(self.protocols.0, self.has_baud_rate);
            if let Some(command) = self.left_over {
                sensor.answer(command);
            }
            let line = ModelLine::new(chooser, sensor, self.fates, draws);
            let begun = Instant::now();
            let run =
                ScenarioRun { scenario: self, line: &line, depth, deed, done: Cell::new(false) };
            let outcome = timeout(LIMIT, run.run()).await;
            let outcome = outcome.unwrap_or_else(|_| Err(format!("it hangs for {LIMIT:?}")));
            let slowest = begun.elapsed();
            let mut state = line.lock();
            let outcome = outcome.map(|scans| SearchFigures { runs: 1, scans, slowest });
            (std::mem::take(&mut state.chooser), outcome, state.drawing.take().unwrap_or_default())
        })
    }
}

/// One run of a scenario.
struct ScenarioRun<'a> {
    scenario: &'a Scenario,
    line: &'a ModelLine,
    depth: Depth,
    deed: Option<(Deed, usize)>,
    /// Set once the deed is done.
    done: Cell<bool>,
}

impl ScenarioRun<'_> {
    /// Returns the number of scans that came, or the promise that was broken.
    async fn run(&self) -> Result<u64, String> {
        let scenario = self.scenario;
        fastrand::seed(1);
        let builder = Sensor::builder().wait_for_sensor(true).depth(256);
        let builder = builder.protocol(scenario.protocols.1);
        let (sensor, driver) = builder.build(self.line.clone());
        let driver = tokio::spawn(driver);
        if scenario.chooses_while_opening {
            self.begin();
        }
        sensor.watch_state().connected().await.map_err(|error| format!("not opened: {error}"))?;
        let mut streams = Vec::new();
        for (window, rate) in &scenario.streams {
            let stream = sensor.scans(*window, *rate).await;
            streams.push(stream.map_err(|error| format!("no stream: {error}"))?);
        }
        if !scenario.chooses_while_opening {
            self.begin();
        }
        let (scans, ()) = tokio::try_join!(self.read(streams), self.act(&sensor))?;
        let is_polled = scenario.streams.iter().all(|(_, rate)| *rate == Rate::hz(0.5));
        if is_polled && self.line.lock().sensor.is_streaming() {
            return Err("the sensor sends scans that nobody wants".to_owned());
        }
        sensor.close().await;
        match driver.await {
            Ok(Ok(())) if self.line.lock().sensor.is_streaming() => {
                Err("the sensor still sends scans".to_owned())
            }
            Ok(Ok(())) => Ok(scans),
            ended => Err(format!("the driver has ended with {ended:?}")),
        }
    }

    fn begin(&self) {
        let cut = match self.deed {
            Some((Deed::Cut(cut), place)) => Some((place, cut)),
            _ => None,
        };
        self.line.begin(self.depth, cut);
    }

    /// Checks all scans, until each stream has brought some after the last choice.
    async fn read(&self, mut streams: Vec<ScanStream>) -> Result<u64, String> {
        let (mut scans, mut done_at) = (0, None);
        for stream in &mut streams {
            let (mut after, mut latest) = (0, None);
            while after < SCANS_AFTER {
                match stream.next().await {
                    Some(Ok(scan)) => {
                        let text = format!("scan {} of {}", scan.sequence(), scan.window());
                        self.line.draw(&text);
                        latest = Some(self.line.lock().sensor.check(&scan, latest)?);
                        if self.done.get() && self.line.is_done() {
                            let done_at = *done_at.get_or_insert_with(Instant::now);
                            after += usize::from(scan.received_at() > done_at);
                        }
                        scans += 1;
                    }
                    Some(Err(error)) => {
                        self.line.draw(&format!("error: {error}"));
                        if self.deed.is_none() && !self.line.lock().is_faulty {
                            return Err("an error without a fault".to_owned());
                        }
                    }
                    None => return Err("the stream has ended".to_owned()),
                }
            }
            if stream.missed() > 0 {
                return Err("a scan was missed".to_owned());
            }
        }
        Ok(scans)
    }

    /// Does the deed of the user in its place. A call may fail, but not lie.
    async fn act(&self, sensor: &Sensor) -> Result<(), String> {
        let Some((deed, place)) = self.deed else {
            self.done.set(true);
            return Ok(());
        };
        self.line.reached(place).await;
        self.line.draw(&format!("the user: {deed:?}"));
        let other_window = Window::new(OTHER_WINDOW).unwrap();
        match deed {
            Deed::Cut(_) => {}
            Deed::Scan => self.check_scan(sensor.scan(other_window).await)?,
            Deed::CancelledScan => tokio::select! {
                biased;
                () = self.line.reached(place + 1) => self.line.draw("the user drops the scan"),
                scan = sensor.scan(other_window) => self.check_scan(scan)?,
            },
            Deed::Stream => {
                let stream = sensor.scans(other_window, Rate::UNLIMITED).await;
                let mut stream = stream.map_err(|error| format!("no stream: {error}"))?;
                loop {
                    match stream.next().await {
                        Some(Ok(scan)) => break self.check_scan(Ok(scan))?,
                        Some(Err(error)) => self.line.draw(&format!("error: {error}")),
                        None => return Err("the other stream has ended".to_owned()),
                    }
                }
            }
            Deed::Laser => {
                let off = sensor.laser_off().await;
                self.line.draw(&format!("laser_off: {off:?}"));
                if off.is_ok() {
                    for _ in 0..2 {
                        if self.line.lock().sensor.is_laser_on {
                            return Err("the laser is on after laser_off".to_owned());
                        }
                        sleep(STAYS_OFF).await;
                    }
                }
                while let Err(error) = sensor.laser_on().await {
                    self.line.draw(&format!("laser_on: {error}"));
                }
                if !self.line.lock().sensor.is_laser_on {
                    return Err("the laser is off after laser_on".to_owned());
                }
            }
            Deed::BaudRate => {
                let changed = sensor.set_baud_rate(OTHER_BAUD_RATE).await;
                self.line.draw(&format!("set_baud_rate: {changed:?}"));
                let baud_rate = self.line.lock().sensor.baud_rate;
                if changed.is_ok() && baud_rate.is_some_and(|now| now != OTHER_BAUD_RATE) {
                    return Err(format!("{baud_rate:?} after set_baud_rate"));
                }
            }
        }
        self.done.set(true);
        Ok(())
    }

    fn check_scan(&self, scan: Result<tokio_scip::Scan, Error>) -> Result<(), String> {
        match scan {
            Ok(scan) => self.line.lock().sensor.check(&scan, None).map(drop),
            Err(error) => {
                self.line.draw(&format!("scan: {error}"));
                Ok(())
            }
        }
    }
}
