//! The radar: the loop over scans, keys and time, which draws a frame after each
//! change. Scans come from sensors or from the playback of a recording. No sensor's
//! trouble ends the picture of another one.

mod chart;
mod common_frame;
mod draw;
mod help;
mod layer;
mod model;
mod palette;
mod panel;
mod radar;
mod save;
mod screen;
mod several;
mod source;
#[cfg(test)]
mod tests;
mod window_keys;

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{Event, EventStream};
use futures_core::Stream;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_scip::{Error, Rate, Scan, ScanStream, Sensor, Version, Window};

pub(crate) use self::screen::Screen;

use self::layer::Layer;
use self::model::{Action, Model};
use self::palette::Palette;
use self::source::{Arrival, Live, Playback, Source, change_of_any, next_of_any};
use crate::failure::{Failure, chain};
use crate::playback::{PlaybackArgs, Shown};
use crate::port::placed::PlacedPort;
use crate::recording::recorded::Recorded;
use crate::stream::follow::Ended;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::end;

/// The shortest time between two frames: 20 a second.
const FRAME_INTERVAL: Duration = Duration::from_millis(50);
/// The refresh interval of everything that is shown in seconds.
const REFRESH_INTERVAL: Duration = Duration::from_secs(1);

/// Sources of scans and their radar.
pub(crate) struct Viewer {
    /// One for each layer of the model.
    sources: Vec<Source>,
    /// The number of sources that have not ended.
    going: usize,
    /// The sensors that are not open yet.
    starts: JoinSet<Started>,
    /// The requests of keys that are not done yet.
    jobs: JoinSet<Outcome>,
    model: Model,
    palette: Palette,
}

/// A sensor to show. It may not be open yet, and may never be.
pub(crate) struct ViewedSensor {
    pub(crate) placed: PlacedPort,
    pub(crate) sensor: Sensor,
    pub(crate) window: Window,
    pub(crate) rate: Rate,
}

/// The outcome of opening the sensor of this number.
type Started = (usize, Result<(Version, ScanStream), Error>);

/// The outcome of a request of a key. The numbers are those of sources.
#[derive(Debug)]
enum Outcome {
    Watching(usize, Window, Result<ScanStream, Error>),
    Laser(usize, bool, Result<(), Error>),
    Saved(Result<String, String>),
}

impl Viewer {
    /// Begins to poll each sensor once it is open.
    pub(crate) fn of_sensors(sensors: Vec<ViewedSensor>) -> Self {
        let (mut sources, mut layers, mut starts) = (Vec::new(), Vec::new(), JoinSet::new());
        for (number, viewed) in sensors.into_iter().enumerate() {
            let ViewedSensor { placed: PlacedPort { named, pose }, sensor, window, rate } = viewed;
            let port = named.port;
            let layer = Layer::new(named.name, pose, port.to_string(), window);
            layers.push(Layer { rate, ..layer });
            let started = source::start(sensor.clone(), window, rate);
            starts.spawn(async move { (number, started.await) });
            let pace = RateWatch::new(&port, window, rate);
            sources.push(Source::Sensor(Box::new(Live { port, sensor, scans: None, pace })));
        }
        Self { starts, ..Self::new(sources, Model::new(layers)) }
    }

    /// Begins to play.
    pub(crate) async fn of_recording(
        placed: &PlacedPort,
        recorded: &Recorded,
        window: Window,
        settings: PlaybackArgs,
    ) -> Result<Self, Failure> {
        let (playback, version) = Playback::start(recorded, settings).await?;
        let (name, port) = (placed.named.name.clone(), placed.named.port.to_string());
        let layer = Layer::new(name, placed.pose, port, window);
        let mut model = Model::new(vec![Layer { version: Some(version), ..layer }]);
        model.playback = Some(playback.player.status());
        Ok(Self::new(vec![Source::Playback(playback)], model))
    }

    fn new(sources: Vec<Source>, model: Model) -> Self {
        let palette = Palette::of(|name| std::env::var_os(name));
        let (starts, jobs) = (JoinSet::new(), JoinSet::new());
        Self { going: sources.len(), sources, starts, jobs, model, palette }
    }

    /// Shows it until the user has seen enough, or all sensors are lost for good.
    pub(crate) async fn run(&mut self, screen: &mut Screen) -> Result<Ended, Failure> {
        let mut keys = EventStream::new();
        let mut states: Vec<_> = self.sensors().map(|live| live.sensor.state()).collect();
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
                    let mut help = None;
                    screen.draw(|frame| help = draw::draw(frame, &self.model, self.palette))?;
                    self.model.help = help;
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
                (number, arrival) = next_of_any(&mut self.sources) => match arrival {
                    Arrival::Scan(scan) => self.scanned(number, scan),
                    Arrival::Trouble(error) => self.trouble(number, &error),
                    Arrival::Moved(scan, status) => self.model.moved(&scan, status),
                    Arrival::End => self.going = self.going.saturating_sub(1),
                },
                Some(started) = self.starts.join_next() => {
                    if let Ok(started) = started {
                        self.started(started)?;
                    }
                }
                Some(done) = self.jobs.join_next() => {
                    if let Ok(done) = done {
                        self.done(done);
                    }
                }
                () = change_of_any(&mut states) => {}
                _ = tick.tick() => {}
            }
            if self.going == 0 {
                return Ok(Ended::ByItself);
            }
            changed = true;
        }
    }

    /// Maps the end of the streams to that of the program: the first sensor that has
    /// failed is its failure. It writes notices, so the terminal must be restored
    /// before.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        self.sensors().try_for_each(|live| end(&live.port, &live.sensor))
    }

    /// Waits a limited time for the last requests, so that no picture is cut off.
    pub(crate) async fn finish(mut self) {
        let done = async { while self.jobs.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(REFRESH_INTERVAL, done).await;
    }

    /// Updates the model with the current state and figures.
    fn refresh(&mut self) {
        self.model.now = Instant::now();
        for (source, layer) in self.sources.iter().zip(&mut self.model.layers) {
            if let Source::Sensor(live) = source {
                layer.state = live.sensor.state().borrow().clone();
                layer.stats = live.sensor.stats();
            }
        }
    }

    fn sensors(&self) -> impl Iterator<Item = &Live> {
        self.sources.iter().filter_map(|source| match source {
            Source::Sensor(live) => Some(&**live),
            Source::Playback(_) => None,
        })
    }

    /// Returns a sensor and its layer.
    fn sensor_mut(&mut self, number: usize) -> Option<(&mut Live, &mut Layer)> {
        match (self.sources.get_mut(number)?, self.model.layers.get_mut(number)?) {
            (Source::Sensor(live), layer) => Some((live, layer)),
            (Source::Playback(_), _) => None,
        }
    }

    fn scanned(&mut self, number: usize, scan: Scan) {
        let Some((live, layer)) = self.sensor_mut(number) else { return };
        if !layer.is_connected() {
            live.pace.restart();
        }
        let notice = live.pace.scanned(&scan, &live.sensor);
        self.model.scanned(number, scan);
        if let Some(text) = notice {
            self.show(number, text);
        }
    }

    fn trouble(&mut self, number: usize, error: &Error) {
        // A lost link is shown as long as it lasts, by its state.
        if !matches!(error, Error::Disconnected { .. }) {
            self.show(number, chain(error));
        }
    }

    /// Shows a message about a sensor. If there are several, the message has its name, or
    /// the port of one without a name.
    fn show(&mut self, number: usize, text: impl Into<String>) {
        self.model.now = Instant::now();
        let text = text.into();
        let layer = self.model.layers.get(number).filter(|_| self.model.has_several());
        self.model.show(match layer {
            Some(layer) if layer.name.is_some() || !text.contains(&layer.port) => {
                format!("{}: {text}", layer.label())
            }
            _ => text,
        });
    }

    /// Starts what a key requests of the selected sensor.
    fn act(&mut self, action: Option<Action>) {
        let number = self.model.selected_number();
        let (Some(source), Some(layer)) = (self.sources.get(number), self.model.selected()) else {
            return;
        };
        match (action, source) {
            (Some(Action::Watch(window)), Source::Sensor(live)) => {
                let (sensor, rate) = (live.sensor.clone(), layer.rate);
                self.jobs.spawn(async move {
                    Outcome::Watching(number, window, sensor.scans(window, rate).await)
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
                    Outcome::Laser(number, on, switched)
                });
            }
            (Some(Action::Laser(_)), Source::Playback(_)) => {
                self.show(number, "a recording has no laser to switch");
            }
            (Some(Action::Playback(command)), Source::Playback(playback)) => {
                playback.player.send(command);
            }
            (Some(Action::Save), _) => match (layer.scan.clone(), layer.version.clone()) {
                (Some(scan), Some(version)) => {
                    self.jobs.spawn_blocking(move || Outcome::Saved(save::save(&scan, &version)));
                }
                _ => self.show(number, "no scan to save yet"),
            },
            (Some(Action::Playback(_)), Source::Sensor(_)) | (Some(Action::Quit) | None, _) => {}
        }
    }

    /// Takes what a request has brought.
    fn done(&mut self, done: Outcome) {
        match done {
            Outcome::Watching(number, window, outcome) => self.watching(number, window, outcome),
            Outcome::Laser(number, on, Ok(())) => {
                if let Some((live, layer)) = self.sensor_mut(number) {
                    layer.laser = on;
                    live.pace.restart();
                }
                let text =
                    if on { "the laser is on" } else { "the laser is off: l switches it on" };
                self.show(number, text);
            }
            Outcome::Laser(number, _, Err(error)) => {
                self.show(number, format!("the laser was not switched: {}", chain(&error)));
            }
            Outcome::Saved(Ok(path)) => {
                self.show(self.model.selected_number(), format!("saved as {path}"))
            }
            Outcome::Saved(Err(error)) => self.show(self.model.selected_number(), error),
        }
    }

    /// Takes the first stream of a sensor. One that cannot be polled has ended; if it was
    /// the last one, that is a failure.
    fn started(&mut self, (number, outcome): Started) -> Result<(), Failure> {
        let Some((live, layer)) = self.sensor_mut(number) else { return Ok(()) };
        match outcome {
            Ok((version, scans)) => {
                layer.version = Some(version);
                // The scans of another window may have been requested, and be there, already.
                live.scans.get_or_insert(scans);
                live.pace.restart();
            }
            Err(error) => {
                let failure = Failure::at(&live.port.to_string(), &error);
                self.going = self.going.saturating_sub(1);
                if self.going == 0 {
                    return Err(failure);
                }
                self.show(number, failure.line());
            }
        }
        Ok(())
    }

    /// Takes the scans of another window.
    fn watching(&mut self, number: usize, window: Window, outcome: Result<ScanStream, Error>) {
        let Some((live, layer)) = self.sensor_mut(number) else { return };
        // The window may have been changed again meanwhile.
        if window != layer.window {
            return;
        }
        match outcome {
            Ok(scans) => {
                live.scans = Some(scans);
                live.pace = RateWatch::new(&live.port, window, layer.rate);
            }
            Err(error) => {
                layer.window = live.scans.as_ref().map_or(layer.window, ScanStream::window);
                self.show(number, format!("the window stays as it was: {}", chain(&error)));
            }
        }
    }
}

/// Returns the next key, or change of the terminal's size; `None` once its input has
/// ended.
async fn next_event(events: &mut EventStream) -> Option<io::Result<Event>> {
    poll_fn(|cx| Pin::new(&mut *events).poll_next(cx)).await
}
