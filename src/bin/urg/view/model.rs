//! The state of the radar, and the effect of each key on it, without a terminal
//! and without a sensor. Keys act on the picture, on the selected sensor, or on the
//! playback; the help names them in these groups.

use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use tokio_scip::{Scan, Window};

use super::layer::Layer;
use super::window_keys::{ARROW_STEPS, moved, next_cluster, next_window};
use crate::playback::{PlaybackCommand, PlaybackStatus, seen_through};
use crate::plot::REACH;
use crate::plot::pose::Pose;

/// The range of the radar at each zoom, in metres.
const ZOOMS: [f64; 5] = [REACH, 3.0, 2.0, 1.0, 0.5];
/// A trail of a playback has no gap of more scans than this.
const MAX_JUMP: u64 = 100;
/// A message is shown for this time.
const MESSAGE_TIME: Duration = Duration::from_secs(6);

/// All that is on the screen.
#[derive(Debug)]
pub(crate) struct Model {
    /// The sensors, in the order of the command line.
    pub(crate) layers: Vec<Layer>,
    /// The number of the sensor that keys act on.
    selected: usize,
    pub(crate) paused: bool,
    /// The first line of the help that is shown, while it is. A key may move it beyond the
    /// end; drawing returns the place within it.
    pub(crate) help: Option<u16>,
    pub(crate) shows_trail: bool,
    /// The place in the recording; `None` for sensors.
    pub(crate) playback: Option<PlaybackStatus>,
    /// The current time, for everything that is shown in seconds.
    pub(crate) now: Instant,
    message: Option<(Instant, String)>,
    zoom: usize,
}

/// A request of a key to the selected sensor or the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Action {
    Quit,
    Watch(Window),
    Laser(bool),
    Playback(PlaybackCommand),
    Save,
}

impl Model {
    /// Creates a radar. The first layer is selected.
    pub(crate) fn new(layers: Vec<Layer>) -> Self {
        Self {
            layers,
            selected: 0,
            paused: false,
            help: None,
            shows_trail: false,
            playback: None,
            now: Instant::now(),
            message: None,
            zoom: 0,
        }
    }

    /// Returns the number of the selected sensor.
    pub(crate) fn selected_number(&self) -> usize {
        self.selected
    }

    /// Returns the selected sensor.
    pub(crate) fn selected(&self) -> Option<&Layer> {
        self.layers.get(self.selected)
    }

    /// Returns whether there are several sensors.
    pub(crate) fn has_several(&self) -> bool {
        self.layers.len() > 1
    }

    /// Returns whether the picture is one of the common frame, in which each sensor
    /// has its place. Else it is one of the only sensor.
    pub(crate) fn is_common_frame(&self) -> bool {
        self.has_several() || self.layers.iter().any(|layer| layer.pose != Pose::default())
    }

    /// Handles a key. Returns the request if it concerns more than the screen.
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
            KeyCode::Char(_) if control => {}
            // Any key but those that quit closes the help first.
            KeyCode::Char('q') => return Some(Action::Quit),
            code if self.help.is_some() => self.help = scrolled(self.help, code),
            KeyCode::Char('?' | 'h') | KeyCode::F(1) => self.help = Some(0),
            KeyCode::Char('t') => self.shows_trail = !self.shows_trail,
            KeyCode::Char('+' | '=') => self.zoom = (self.zoom + 1).min(ZOOMS.len() - 1),
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
            KeyCode::Char('l') => return self.selected().map(|layer| Action::Laser(!layer.laser)),
            KeyCode::Char('s') => return Some(Action::Save),
            KeyCode::Char('w') => return self.watch(next_window),
            KeyCode::Char('c') => return self.watch(next_cluster),
            KeyCode::Left => return self.watch(|now| moved(now, ARROW_STEPS, ARROW_STEPS)),
            KeyCode::Right => return self.watch(|now| moved(now, -ARROW_STEPS, -ARROW_STEPS)),
            KeyCode::Up => return self.watch(|now| moved(now, -ARROW_STEPS, ARROW_STEPS)),
            KeyCode::Down => return self.watch(|now| moved(now, ARROW_STEPS, -ARROW_STEPS)),
            _ => {}
        }
        None
    }

    /// Returns what a key asks of the playback, if there is one.
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
    fn watch(&mut self, change: impl FnOnce(Window) -> Window) -> Option<Action> {
        let layer = self.layers.get_mut(self.selected)?;
        let window = change(layer.window);
        (window != layer.window).then(|| {
            layer.window = window;
            // A new window is to be seen.
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

    /// Shows the place of the playback, and its scan through the current window.
    pub(crate) fn moved(&mut self, scan: &Scan, status: PlaybackStatus) {
        self.playback = Some(status);
        let Some(layer) = self.layers.get_mut(self.selected) else { return };
        let scan = seen_through(scan, layer.window);
        let before = layer.scan.as_ref().map(|before| (before.sequence(), before.window()));
        if before == Some((scan.sequence(), scan.window())) {
            return;
        }
        // After a jump they would be no trail.
        let near = scan.sequence().saturating_sub(MAX_JUMP)..scan.sequence();
        let shown = layer.trail.iter().chain(&layer.scan);
        if !shown.into_iter().all(|older| near.contains(&older.sequence())) {
            layer.trail.clear();
            layer.scan = None;
        }
        layer.scanned(scan);
    }

    /// Shows a message for some seconds.
    pub(crate) fn show(&mut self, text: impl Into<String>) {
        self.message = Some((self.now, text.into()));
    }

    /// Returns the message to show now.
    pub(crate) fn message(&self) -> Option<&str> {
        let (since, text) = self.message.as_ref()?;
        (self.now.saturating_duration_since(*since) < MESSAGE_TIME).then_some(text)
    }

    /// Returns the range of the radar, in metres.
    pub(crate) fn reach(&self) -> f64 {
        ZOOMS.get(self.zoom).copied().unwrap_or(REACH)
    }

    /// Returns whether a layer shows what it is to show: the present, or a place in a
    /// recording.
    pub(crate) fn is_live(&self, layer: &Layer) -> bool {
        self.playback.is_some() || (layer.is_measuring() && !self.paused)
    }
}

/// Returns the place of the help after a key: scrolled, or `None` when it closes.
fn scrolled(help: Option<u16>, code: KeyCode) -> Option<u16> {
    match code {
        KeyCode::Down => help.map(|line| line.saturating_add(1)),
        KeyCode::Up => help.map(|line| line.saturating_sub(1)),
        _ => None,
    }
}
