//! The radar: the loop over scans, keys and time, which draws a frame after each
//! change. Scans come from a sensor or from the playback of a recording.

mod draw;
mod help;
mod model;
mod palette;
mod panel;
mod radar;
mod save;
mod screen;
mod source;
#[cfg(test)]
mod tests;

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{Event, EventStream};
use futures_core::Stream;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, State, Window};

pub(crate) use self::screen::Screen;

use self::model::{Action, Model};
use self::palette::Palette;
use self::source::{Arrival, Live, Playback, Source};
use crate::failure::{Failure, chain};
use crate::playback::{PlaybackArgs, Shown};
use crate::port::name::PortName;
use crate::recording::recorded::Recorded;
use crate::stream::follow::Ended;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::end;

/// The shortest time between two frames: 20 a second.
const FRAME_INTERVAL: Duration = Duration::from_millis(50);
/// The refresh interval of everything that is shown in seconds.
const REFRESH_INTERVAL: Duration = Duration::from_secs(1);

/// A source of scans and its radar.
pub(crate) struct Viewer {
    port: PortName,
    source: Source,
    /// The requests of keys that are not done yet.
    jobs: JoinSet<Outcome>,
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
    pub(crate) async fn of_sensor(
        port: &PortName,
        sensor: Sensor,
        window: Window,
        rate: Rate,
    ) -> Result<Self, Failure> {
        let failed = |error| Failure::at(&port.to_string(), &error);
        let version = sensor.version().await.map_err(failed)?;
        let live = Live::start(port, sensor, window, rate).await?;
        let model = Model::new(port.to_string(), version, window, rate);
        Ok(Self::new(port, Source::Sensor(Box::new(live)), model))
    }

    /// Begins to play.
    pub(crate) async fn of_recording(
        port: &PortName,
        recorded: &Recorded,
        window: Window,
        settings: PlaybackArgs,
    ) -> Result<Self, Failure> {
        let (playback, version) = Playback::start(recorded, settings).await?;
        let mut model = Model::new(port.to_string(), version, window, Rate::MAX);
        model.playback = Some(playback.player.status());
        Ok(Self::new(port, Source::Playback(playback), model))
    }

    fn new(port: &PortName, source: Source, model: Model) -> Self {
        Self {
            port: port.clone(),
            source,
            jobs: JoinSet::new(),
            model,
            palette: Palette::of(|name| std::env::var_os(name)),
        }
    }

    /// Shows it until the user has seen enough, or the sensor is lost for good.
    pub(crate) async fn run(&mut self, screen: &mut Screen) -> Result<Ended, Failure> {
        let mut keys = EventStream::new();
        let mut state = self.sensor().map(Sensor::state);
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
                event = next_event(&mut keys) => match event {
                    Some(Ok(Event::Key(key))) => match self.model.key(key) {
                        Some(Action::Quit) => return Ok(Ended::Interrupted),
                        action => self.act(action),
                    },
                    // A resize, mostly: the next frame has the new size.
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(Failure::of("cannot read the keyboard", &error)),
                    None => return Ok(Ended::Interrupted),
                },
                arrival = self.source.next() => match arrival {
                    Arrival::Scan(scan) => self.scanned(scan),
                    Arrival::Trouble(error) => self.trouble(&error),
                    Arrival::Moved(scan, status) => self.model.moved(&scan, status),
                    Arrival::End => return Ok(Ended::ByItself),
                },
                Some(done) = self.jobs.join_next() => {
                    if let Ok(done) = done {
                        self.done(done);
                    }
                }
                () = changed_state(state.as_mut()) => {}
                _ = tick.tick() => {}
            }
            changed = true;
        }
    }

    /// Maps the end of the stream to that of the program. It writes a notice, so
    /// the terminal must be restored before.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        match self.sensor() {
            Some(sensor) => end(&self.port, sensor),
            None => Ok(()),
        }
    }

    /// Waits a limited time for the last requests, so that no picture is cut off.
    pub(crate) async fn finish(mut self) {
        let done = async { while self.jobs.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(REFRESH_INTERVAL, done).await;
    }

    /// Updates the model with the current state and figures.
    fn refresh(&mut self) {
        self.model.now = Instant::now();
        if let Some(sensor) = self.sensor() {
            let (state, stats) = (sensor.state().borrow().clone(), sensor.stats());
            (self.model.state, self.model.stats) = (state, stats);
        }
    }

    fn sensor(&self) -> Option<&Sensor> {
        match &self.source {
            Source::Sensor(live) => Some(&live.sensor),
            Source::Playback(_) => None,
        }
    }

    fn scanned(&mut self, scan: Scan) {
        let Source::Sensor(live) = &mut self.source else { return };
        let Live { sensor, pace, .. } = &mut **live;
        if !matches!(self.model.state, State::Connected { .. }) {
            pace.restart();
        }
        let notice = pace.scanned(&scan, sensor);
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
        match (action, &self.source) {
            (Some(Action::Watch(window)), Source::Sensor(live)) => {
                let (sensor, rate) = (live.sensor.clone(), self.model.rate);
                self.jobs.spawn(async move {
                    Outcome::Watching(window, sensor.scans(window, rate).await)
                });
            }
            (Some(Action::Watch(_)), Source::Playback(playback)) => {
                let Shown { scan, status } = playback.player.shown().borrow().clone();
                self.model.moved(&scan, status);
            }
            (Some(Action::Laser(on)), Source::Sensor(live)) => {
                let sensor = live.sensor.clone();
                self.jobs.spawn(async move {
                    let switched =
                        if on { sensor.laser_on().await } else { sensor.laser_off().await };
                    Outcome::Laser(on, switched)
                });
            }
            (Some(Action::Laser(_)), Source::Playback(_)) => {
                self.show("a recording has no laser to switch");
            }
            (Some(Action::Playback(command)), Source::Playback(playback)) => {
                playback.player.send(command);
            }
            (Some(Action::Save), _) => match self.model.scan.clone() {
                Some(scan) => {
                    let version = self.model.version.clone();
                    self.jobs.spawn_blocking(move || Outcome::Saved(save::save(&scan, &version)));
                }
                None => self.show("no scan to save yet"),
            },
            (Some(Action::Playback(_)), Source::Sensor(_)) | (Some(Action::Quit) | None, _) => {}
        }
    }

    fn done(&mut self, done: Outcome) {
        match done {
            Outcome::Watching(window, outcome) => self.watching(window, outcome),
            Outcome::Laser(on, Ok(())) => {
                self.model.laser = on;
                if let Source::Sensor(live) = &mut self.source {
                    live.pace.restart();
                }
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

    /// Takes the scans of another window.
    fn watching(&mut self, window: Window, outcome: Result<ScanStream, Error>) {
        let Source::Sensor(live) = &mut self.source else { return };
        // The window may have been changed again meanwhile.
        if window != self.model.window {
            return;
        }
        match outcome {
            Ok(scans) => {
                live.scans = scans;
                live.pace = RateWatch::new(&self.port, window, self.model.rate);
            }
            Err(error) => {
                self.model.window = live.scans.window();
                self.show(format!("the window stays as it was: {}", chain(&error)));
            }
        }
    }
}

/// Waits for a change of the sensor's state, if there is a sensor. Cancel-safe.
async fn changed_state(state: Option<&mut watch::Receiver<State>>) {
    let is_changed = match state {
        Some(state) => state.changed().await.is_ok(),
        None => false,
    };
    // A driver that has ended changes no more.
    if !is_changed {
        std::future::pending().await
    }
}

/// Returns the next key, or change of the terminal's size; `None` once its input has
/// ended.
async fn next_event(events: &mut EventStream) -> Option<io::Result<Event>> {
    poll_fn(|cx| Pin::new(&mut *events).poll_next(cx)).await
}
