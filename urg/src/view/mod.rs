//! Event loop of the radar. It handles scans, keys and timers, and redraws the screen after
//! each change. Scans come from sensors or from the playback of a recording. Trouble with
//! one sensor leaves the pictures of the others alone.

mod chart;
mod command;
mod draw;
mod help;
mod layer;
mod model;
mod palette;
mod panel;
mod radar;
mod screen;
mod several;
mod source;
mod symbols;
#[cfg(test)]
mod tests;

use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{Event, EventStream};
use futures_util::StreamExt;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_scip::{Error, ErrorKind, Scan, ScanStream, Sensor, Version, Window};

pub(crate) use self::command::View;
use self::layer::Layer;
use self::model::{Action, Model};
use self::palette::Palette;
use self::screen::{Screen, StopRequests};
use self::source::{Arrival, PlayedRecording, PolledSensor, ViewSource, next_of_any};
use crate::failure::{Failure, chain};
use crate::picture::PictureSource;
use crate::playback::{Player, Shown};
use crate::stream::follow::StreamEnd;
use crate::stream::rate_watch::RateWatch;
use crate::stream::reporter::end;

/// Minimum time between two frames: at most 20 frames a second.
const FRAME_INTERVAL: Duration = Duration::from_millis(50);
/// How often to redraw without any change: the screen shows durations in seconds.
const REFRESH_INTERVAL: Duration = Duration::from_secs(1);

/// Radar and the sources of its scans.
pub(crate) struct Viewer {
    /// One per layer of the model, in the same order.
    sources: Vec<ViewSource>,
    /// Number of sources that have not ended.
    open_sources: usize,
    /// Sensors that are still opening.
    starts: JoinSet<Started>,
    /// Pending streams of new windows.
    switches: JoinSet<Switched>,
    model: Model,
    palette: Palette,
}

/// Number of a sensor, and the outcome of opening it.
type Started = (usize, Result<(Version, ScanStream), Error>);

/// Number of a sensor, its new window, and the stream of it.
type Switched = (usize, Window, Result<ScanStream, Error>);

impl Viewer {
    /// Polls each sensor as soon as it is open, which may be never.
    pub(crate) fn from_sensors(sensors: Vec<(PictureSource, Sensor)>) -> Self {
        let (mut sources, mut layers, mut starts) = (Vec::new(), Vec::new(), JoinSet::new());
        for (number, (source, sensor)) in sensors.into_iter().enumerate() {
            let PictureSource { window, rate, .. } = source;
            let started = source::start(sensor.clone(), window, rate);
            starts.spawn(async move { (number, started.await) });
            let pace = RateWatch::new(&source.port, window, rate);
            let port = source.port.clone();
            let polled = PolledSensor { port, sensor, scans: None, pace };
            sources.push(ViewSource::Sensor(Box::new(polled)));
            layers.push(Layer::new(source));
        }
        Self { starts, ..Self::new(sources, Model::new(layers)) }
    }

    /// Shows a playback, whose recording is `source`.
    pub(crate) fn from_recording(source: PictureSource, player: Player) -> Self {
        let version = Some(player.version().clone());
        let mut model = Model::new(vec![Layer { version, ..Layer::new(source) }]);
        let mut shown = player.shown();
        // The first scan must arrive as a change, too.
        shown.mark_changed();
        model.playback = Some(player.status());
        Self::new(vec![ViewSource::Playback(PlayedRecording { player, shown })], model)
    }

    fn new(sources: Vec<ViewSource>, model: Model) -> Self {
        let palette = Palette::from_environment(|name| std::env::var_os(name));
        let (starts, switches) = (JoinSet::new(), JoinSet::new());
        Self { open_sources: sources.len(), sources, starts, switches, model, palette }
    }

    /// Runs until the user quits or every source has ended.
    pub(crate) async fn run(&mut self, screen: &mut Screen) -> Result<StreamEnd, Failure> {
        let mut keys = EventStream::new();
        let mut tick = tokio::time::interval(REFRESH_INTERVAL);
        tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut next_frame = Instant::now();
        let mut stop = StopRequests::listen();
        let mut changed = true;
        loop {
            let frame = async {
                tokio::time::sleep_until(next_frame).await;
                screen.ready().await
            };
            tokio::select! {
                // Keys first: pasted text must not delay Ctrl-C by a frame for each of its letters.
                biased;
                event = keys.next() => match event {
                    Some(Ok(Event::Key(key))) => match self.model.key(key) {
                        Some(Action::Quit) => return Ok(StreamEnd::Interrupted),
                        Some(Action::Suspend) => screen.suspend().await?,
                        action => self.act(action),
                    },
                    // Usually a resize: the next frame is drawn at the new size.
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(Failure::new("cannot read the keyboard", &error)),
                    // The terminal's input has ended.
                    None => return Ok(StreamEnd::Interrupted),
                },
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
                (number, arrival) = next_of_any(&mut self.sources) => match arrival {
                    Arrival::Scan(scan) => self.scanned(number, scan),
                    Arrival::Trouble(error) => self.trouble(number, &error),
                    Arrival::Moved(scan, status) => self.model.moved(&scan, status),
                    Arrival::End => self.open_sources = self.open_sources.saturating_sub(1),
                },
                Some(started) = self.starts.join_next() => {
                    if let Ok(started) = started {
                        self.started(started)?;
                    }
                }
                Some(switched) = self.switches.join_next() => {
                    if let Ok(switched) = switched {
                        self.switched(switched);
                    }
                }
                () = stop.requested() => screen.suspend().await?,
                _ = tick.tick() => {}
            }
            if self.open_sources == 0 {
                return Ok(StreamEnd::ByItself);
            }
            changed = true;
        }
    }

    /// Computes the program's outcome: the failure of the first sensor that has failed.
    /// Restore the terminal first, because this writes notices.
    pub(crate) fn end(&self) -> Result<(), Failure> {
        self.sources.iter().try_for_each(|source| match source {
            ViewSource::Sensor(live) => end(&live.port, &live.sensor),
            ViewSource::Playback(playback) => playback.player.failure().map_or(Ok(()), Err),
        })
    }

    /// Copies the sensors' current state and statistics to the model.
    fn refresh(&mut self) {
        self.model.now = Instant::now();
        for (source, layer) in self.sources.iter().zip(&mut self.model.layers) {
            if let ViewSource::Sensor(live) = source {
                layer.state = live.sensor.watch_state().get();
                layer.stats = live.sensor.stats();
            }
        }
    }

    fn sensor_mut(&mut self, number: usize) -> Option<(&mut PolledSensor, &mut Layer)> {
        match (self.sources.get_mut(number)?, self.model.layers.get_mut(number)?) {
            (ViewSource::Sensor(live), layer) => Some((live, layer)),
            (ViewSource::Playback(_), _) => None,
        }
    }

    fn scanned(&mut self, number: usize, scan: Scan) {
        let Some((live, _)) = self.sensor_mut(number) else { return };
        let notice = live.pace.scanned(&live.sensor);
        self.model.scanned(number, scan);
        if let Some(text) = notice {
            self.show(number, text);
        }
    }

    fn trouble(&mut self, number: usize, error: &Error) {
        // The state of the layer already shows a lost link, for as long as it lasts.
        if !matches!(error.kind(), ErrorKind::Disconnected { .. }) {
            self.show(number, chain(error));
        }
    }

    /// Shows a message about a sensor, with its name or port if there are several.
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

    /// Starts the action of a key on the selected sensor.
    fn act(&mut self, action: Option<Action>) {
        let number = self.model.selected_number();
        let (Some(source), Some(layer)) = (self.sources.get(number), self.model.selected()) else {
            return;
        };
        match (action, source) {
            (Some(Action::Watch(window)), ViewSource::Sensor(live)) => {
                let (sensor, rate) = (live.sensor.clone(), layer.rate);
                self.switches
                    .spawn(async move { (number, window, sensor.scans(window, rate).await) });
            }
            (Some(Action::Watch(_)), ViewSource::Playback(playback)) => {
                let Shown { scan, status } = playback.player.shown().borrow().clone();
                self.model.moved(&scan, status);
            }
            (Some(Action::Playback(command)), ViewSource::Playback(playback)) => {
                playback.player.send(command);
            }
            (Some(Action::Playback(_)), ViewSource::Sensor(_))
            | (Some(Action::Quit | Action::Suspend) | None, _) => {}
        }
    }

    /// Applies the outcome of opening a sensor. A sensor that failed to open counts as
    /// ended. If it was the last source, its error ends the program.
    fn started(&mut self, (number, outcome): Started) -> Result<(), Failure> {
        let Some((live, layer)) = self.sensor_mut(number) else { return Ok(()) };
        match outcome {
            Ok((version, scans)) => {
                layer.version = Some(version);
                // A key may already have requested another window, whose stream must stay.
                live.scans.get_or_insert(scans);
            }
            Err(error) => {
                let failure = Failure::at(&live.port, &error);
                self.open_sources = self.open_sources.saturating_sub(1);
                if self.open_sources == 0 {
                    return Err(failure);
                }
                self.show(number, failure.line());
            }
        }
        Ok(())
    }

    /// Switches a sensor to the stream of its new window.
    fn switched(&mut self, (number, window, outcome): Switched) {
        let Some((live, layer)) = self.sensor_mut(number) else { return };
        // A newer key may have changed the window again.
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
