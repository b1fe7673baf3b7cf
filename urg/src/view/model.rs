//! State of the radar and the effect of each key on it, without a terminal or a sensor. Keys act on
//! the picture, on the selected sensor or on the playback. The help groups them the same way.

use std::iter;
use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use tokio_scip::protocol::Protocol;
use tokio_scip::scan::Pose;
use tokio_scip::{Scan, Window};

use super::layer::Layer;
use crate::playback::{PlaybackCommand, PlaybackStatus, seen_through};

/// Ranges of the radar in metres, from which zooming in takes those within the sensors' reach.
const ZOOMS: [f64; 8] = [30.0, 20.0, 10.0, 5.0, 3.0, 2.0, 1.0, 0.5];
/// How long a message stays on the screen.
const MESSAGE_TIME: Duration = Duration::from_secs(6);

/// Cluster counts that a key steps through.
const CLUSTERS: [u8; 4] = [1, 2, 4, 8];

/// Everything that is on the screen.
#[derive(Debug)]
pub(crate) struct Model {
    /// Sensors in the order of the command line.
    pub(crate) layers: Vec<Layer>,
    /// Number of the sensor that keys act on.
    selected: usize,
    pub(crate) paused: bool,
    /// First visible line of the help; `None` while the help is closed. A key may move it
    /// past the end, and drawing moves it back.
    pub(crate) help: Option<u16>,
    /// Position in the recording; `None` for sensors.
    pub(crate) playback: Option<PlaybackStatus>,
    /// Current time, for the durations on the screen.
    pub(crate) now: Instant,
    message: Option<(Instant, String)>,
    zoom: usize,
}

/// Request from a key to the selected sensor or to the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Action {
    Quit,
    Suspend,
    Watch(Window),
    Playback(PlaybackCommand),
}

impl Model {
    pub(crate) fn new(layers: Vec<Layer>) -> Self {
        Self {
            layers,
            selected: 0,
            paused: false,
            help: None,
            playback: None,
            now: Instant::now(),
            message: None,
            zoom: 0,
        }
    }

    pub(crate) fn selected_number(&self) -> usize {
        self.selected
    }

    pub(crate) fn selected(&self) -> Option<&Layer> {
        self.layers.get(self.selected)
    }

    pub(crate) fn has_several(&self) -> bool {
        self.layers.len() > 1
    }

    /// Checks whether to draw the sensors at their places in the common frame. A single
    /// sensor without a pose has a picture of its own.
    pub(crate) fn is_common_frame(&self) -> bool {
        self.has_several() || self.layers.iter().any(|layer| layer.pose != Pose::default())
    }

    /// Handles a key. Returns an action if the key concerns more than the screen.
    pub(crate) fn key(&mut self, key: KeyEvent) -> Option<Action> {
        if key.kind == KeyEventKind::Release {
            return None;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        if let Some(command) = self.command(key.code, key.modifiers)
            && self.help.is_none()
            && !control
        {
            return Some(Action::Playback(command));
        }
        match key.code {
            KeyCode::Char('c') if control => return Some(Action::Quit),
            KeyCode::Char('z') if control => return Some(Action::Suspend),
            KeyCode::Char(_) if control => {}
            // While the help is open, every other key scrolls or closes it.
            KeyCode::Char('q') => return Some(Action::Quit),
            code if self.help.is_some() => self.help = scrolled(self.help, code),
            KeyCode::Char('?' | 'h') | KeyCode::F(1) => self.help = Some(0),
            KeyCode::Char('+' | '=') => self.zoom = (self.zoom + 1).min(self.zooms().count() - 1),
            KeyCode::Char('-' | '_') => self.zoom = self.zoom.saturating_sub(1),
            KeyCode::Char('0') => self.zoom = 0,
            KeyCode::Char(' ' | 'p') => self.paused = !self.paused,
            KeyCode::Tab => self.selected = (self.selected + 1) % self.layers.len().max(1),
            KeyCode::BackTab => {
                let before = self.selected.checked_sub(1);
                self.selected = before.unwrap_or(self.layers.len().saturating_sub(1));
            }
            KeyCode::Char(digit @ '1'..='9') => {
                let number = digit as usize - '1' as usize;
                if number < self.layers.len() {
                    self.selected = number;
                }
            }
            KeyCode::Char('w') => return self.watch(next_window),
            KeyCode::Char('c') => return self.watch(|layer| next_cluster(layer.window)),
            _ => {}
        }
        None
    }

    /// Maps a key to a playback command; `None` without a playback.
    fn command(&self, key: KeyCode, modifiers: KeyModifiers) -> Option<PlaybackCommand> {
        use PlaybackCommand::{Loop, Seek, SeekBy, Speed, Step, Toggle};
        let status = self.playback?;
        let far = if modifiers.contains(KeyModifiers::SHIFT) { 60.0 } else { 5.0 };
        Some(match key {
            KeyCode::Char(' ' | 'p') => Toggle,
            KeyCode::Char('.' | '>') => Step(1),
            KeyCode::Char(',' | '<') => Step(-1),
            KeyCode::Right => SeekBy(far),
            KeyCode::Left => SeekBy(-far),
            KeyCode::Home => Seek(0.0),
            KeyCode::End => Seek(status.length),
            KeyCode::Char(']') => Speed(status.speed * 2.0),
            KeyCode::Char('[') => Speed(status.speed / 2.0),
            KeyCode::Char('o') => Loop(!status.is_looping),
            _ => return None,
        })
    }

    /// Changes the window of the selected sensor.
    fn watch(&mut self, change: impl FnOnce(&Layer) -> Window) -> Option<Action> {
        let layer = self.layers.get_mut(self.selected)?;
        let window = change(layer);
        (window != layer.window).then(|| {
            layer.window = window;
            // A paused picture would hide the new window.
            self.paused = false;
            Action::Watch(window)
        })
    }

    /// Shows a new scan of a sensor, unless the picture is paused.
    pub(crate) fn scanned(&mut self, number: usize, scan: Scan) {
        if let Some(layer) = self.layers.get_mut(number)
            && !self.paused
        {
            layer.scanned(scan);
        }
    }

    /// Shows the position of the playback, and its scan in the current window.
    pub(crate) fn moved(&mut self, scan: &Scan, status: PlaybackStatus) {
        self.playback = Some(status);
        let Some(layer) = self.layers.get_mut(self.selected) else { return };
        layer.show(self.now, seen_through(scan, layer.window));
    }

    pub(crate) fn show(&mut self, text: impl Into<String>) {
        self.message = Some((self.now, text.into()));
    }

    pub(crate) fn message(&self) -> Option<&str> {
        let (since, text) = self.message.as_ref()?;
        (self.now.saturating_duration_since(*since) < MESSAGE_TIME).then_some(text)
    }

    /// Range of the radar at the current zoom, in metres.
    pub(crate) fn reach(&self) -> f64 {
        self.zooms().nth(self.zoom).unwrap_or_else(|| self.whole_reach())
    }

    /// Iterates over the ranges of all zoom levels, from the whole picture inwards.
    fn zooms(&self) -> impl Iterator<Item = f64> {
        let whole = self.whole_reach();
        iter::once(whole).chain(ZOOMS.into_iter().filter(move |range| *range < whole))
    }

    /// Distance from a sensor to the rim of its sector, in metres.
    pub(crate) fn reach_of(&self, layer: &Layer) -> f64 {
        layer.reach.metres.min(self.reach())
    }

    fn whole_reach(&self) -> f64 {
        self.layers.iter().map(|layer| layer.reach.metres).fold(0.0, f64::max)
    }

    /// Checks whether the scan of a layer is current. A playback is always current.
    pub(crate) fn is_live(&self, layer: &Layer) -> bool {
        self.playback.is_some() || (layer.is_connected() && !self.paused)
    }
}

/// Scrolls the help by a key. Keys other than up and down close it.
fn scrolled(help: Option<u16>, code: KeyCode) -> Option<u16> {
    match code {
        KeyCode::Down => help.map(|line| line.saturating_add(1)),
        KeyCode::Up => help.map(|line| line.saturating_sub(1)),
        _ => None,
    }
}

/// Steps through the most useful windows. Keeps the cluster count.
fn next_window(layer: &Layer) -> Window {
    let window = layer.window;
    let degrees = |most: f64| Window::degrees(-most..=most).unwrap_or(Window::DETECTION);
    let mut windows = vec![Window::DETECTION, degrees(90.0), degrees(45.0)];
    // Only in SCIP 1.1 a sensor answers for steps that it does not measure.
    if layer.geometry().protocol() == Protocol::Scip1 {
        windows.push(Window::FULL);
    }
    let same = |other: &Window| (other.start(), other.end()) == (window.start(), window.end());
    // The last window leads to the first, and so does a window outside the list.
    let next = windows.iter().skip_while(|other| !same(other)).nth(1);
    let next = next.copied().unwrap_or(Window::DETECTION);
    next.with_cluster_count(window.cluster_count()).unwrap_or(next)
}

fn next_cluster(window: Window) -> Window {
    let next = CLUSTERS.into_iter().find(|count| *count > window.cluster_count()).unwrap_or(1);
    window.with_cluster_count(next).unwrap_or(window)
}
