//! The live radar: the loop over scans, keys and time, which draws a frame after
//! each change.

mod draw;
mod help;
mod model;
mod palette;
mod panel;
mod radar;
mod save;
mod screen;
#[cfg(test)]
mod tests;

use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{Event, EventStream};
use futures::StreamExt;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, State, Window};

pub(crate) use self::screen::Screen;

use self::model::{Action, Model};
use self::palette::Palette;
use crate::failure::{Failure, chain};
use crate::port::name::PortName;
use crate::stream::follow::Ended;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::end;

/// The shortest time between two frames: 20 a second.
const FRAME_INTERVAL: Duration = Duration::from_millis(50);
/// The refresh interval of everything that is shown in seconds.
const REFRESH_INTERVAL: Duration = Duration::from_secs(1);

/// A sensor and its radar.
pub(crate) struct Viewer {
    port: PortName,
    sensor: Sensor,
    scans: ScanStream,
    /// The requests of keys that are not done yet.
    jobs: JoinSet<Outcome>,
    pace: RateWatch,
    model: Model,
    palette: Palette,
}

/// The outcome of a request of a key.
#[derive(Debug)]
enum Outcome {
    Watching(Window, Result<ScanStream, Error>),
    Laser(bool, Result<(), Error>),
    Saved(Result<String, String>),
}

impl Viewer {
    /// Begins to poll.
    pub(crate) async fn new(
        port: &PortName,
        sensor: Sensor,
        window: Window,
        rate: Rate,
    ) -> Result<Self, Failure> {
        let failed = |error| Failure::at(&port.to_string(), &error);
        let version = sensor.version().await.map_err(failed)?;
        let scans = sensor.scans(window, rate).await.map_err(failed)?;
        Ok(Self {
            pace: RateWatch::new(port, window, rate),
            model: Model::new(port.to_string(), version, window, rate),
            port: port.clone(),
            sensor,
            scans,
            jobs: JoinSet::new(),
            palette: Palette::of(|name| std::env::var_os(name)),
        })
    }

    /// Shows it until the user has seen enough, or the sensor is lost for good.
    pub(crate) async fn run(&mut self, screen: &mut Screen) -> Result<Ended, Failure> {
        let mut keys = EventStream::new();
        let mut state = self.sensor.state();
        let mut tick = tokio::time::interval(REFRESH_INTERVAL);
        tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut next_frame = Instant::now();
        let mut changed = true;
        loop {
            let frame = async {
                tokio::time::sleep_until(next_frame).await;
                screen.ready().await
            };
            tokio::select! {
                ready = frame, if changed => {
                    ready?;
                    changed = false;
                    next_frame = Instant::now() + FRAME_INTERVAL;
                    self.refresh();
                    screen.draw(|frame| draw::draw(frame, &self.model, self.palette))?;
                    continue;
                }
                event = keys.next() => match event {
                    Some(Ok(Event::Key(key))) => match self.model.key(key) {
                        Some(Action::Quit) => return Ok(Ended::Interrupted),
                        action => self.act(action),
                    },
                    // A resize, mostly: the next frame has the new size.
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(Failure::of("cannot read the keyboard", &error)),
                    None => return Ok(Ended::Interrupted),
                },
                item = self.scans.next() => match item {
                    Some(Ok(scan)) => self.scanned(scan),
                    Some(Err(error)) => self.trouble(&error),
                    None => return Ok(Ended::ByItself),
                },
                Some(done) = self.jobs.join_next() => {
                    if let Ok(done) = done {
                        self.done(done);
                    }
                }
                _ = state.changed() => {}
                _ = tick.tick() => {}
            }
            changed = true;
        }
    }

    /// Maps the end of the stream to that of the program. It writes a notice, so
    /// the terminal must be restored before.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        end(&self.port, &self.sensor)
    }

    /// Waits a limited time for the last requests, so that no picture is cut off.
    pub(crate) async fn finish(mut self) {
        let done = async { while self.jobs.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(REFRESH_INTERVAL, done).await;
    }

    /// Updates the model with the current state and figures.
    fn refresh(&mut self) {
        self.model.now = Instant::now();
        self.model.state = self.sensor.state().borrow().clone();
        self.model.stats = self.sensor.stats();
    }

    fn scanned(&mut self, scan: Scan) {
        if !matches!(self.model.state, State::Connected { .. }) {
            self.pace.restart();
        }
        let notice = self.pace.scanned(&scan, &self.sensor);
        self.model.scanned(scan);
        if let Some(text) = notice {
            self.show(text);
        }
    }

    fn trouble(&mut self, error: &Error) {
        // A lost link is shown as long as it lasts, by its state.
        if !matches!(error, Error::Disconnected { .. }) {
            self.show(chain(error));
        }
    }

    fn show(&mut self, text: impl Into<String>) {
        self.model.now = Instant::now();
        self.model.show(text);
    }

    /// Starts what a key requests.
    fn act(&mut self, action: Option<Action>) {
        let sensor = self.sensor.clone();
        match action {
            Some(Action::Watch(window)) => {
                let rate = self.model.rate;
                self.jobs.spawn(async move {
                    Outcome::Watching(window, sensor.scans(window, rate).await)
                });
            }
            Some(Action::Laser(on)) => {
                self.jobs.spawn(async move {
                    let switched =
                        if on { sensor.laser_on().await } else { sensor.laser_off().await };
                    Outcome::Laser(on, switched)
                });
            }
            Some(Action::Save) => match self.model.scan.clone() {
                Some(scan) => {
                    let version = self.model.version.clone();
                    self.jobs.spawn_blocking(move || Outcome::Saved(save::save(&scan, &version)));
                }
                None => self.show("no scan to save yet"),
            },
            Some(Action::Quit) | None => {}
        }
    }

    fn done(&mut self, done: Outcome) {
        match done {
            // The window may have been changed again meanwhile.
            Outcome::Watching(window, Ok(scans)) if window == self.model.window => {
                self.scans = scans;
                self.pace = RateWatch::new(&self.port, window, self.model.rate);
            }
            Outcome::Watching(window, Err(error)) if window == self.model.window => {
                self.model.window = self.scans.window();
                self.show(format!("the window stays as it was: {}", chain(&error)));
            }
            Outcome::Watching(..) => {}
            Outcome::Laser(on, Ok(())) => {
                self.model.laser = on;
                self.pace.restart();
                self.show(if on {
                    "the laser is on"
                } else {
                    "the laser is off: l switches it on"
                });
            }
            Outcome::Laser(_, Err(error)) => {
                self.show(format!("the laser was not switched: {}", chain(&error)));
            }
            Outcome::Saved(Ok(path)) => self.show(format!("saved as {path}")),
            Outcome::Saved(Err(error)) => self.show(error),
        }
    }
}
