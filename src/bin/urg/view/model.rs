//! The state of the radar, and the effect of each key on it, without a terminal
//! and without a sensor.

use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use tokio_scip::{Rate, Scan, ScheduleStats, State, Stats, Version, Window};

use crate::playback::{PlaybackCommand, PlaybackStatus, seen_through};
use crate::plot::REACH;

/// The range of the radar at each zoom, in metres.
const ZOOMS: [f64; 5] = [REACH, 3.0, 2.0, 1.0, 0.5];
/// The cluster counts that a key steps through.
const CLUSTERS: [u8; 4] = [1, 2, 4, 8];
/// The steps by which an arrow key turns or widens the window: 15 degrees.
const ARROW_STEPS: i32 = 43;
/// A window that is narrowed keeps at least so many steps.
const MIN_STEPS: i32 = 86;
/// The trail has no more scans than this.
const MAX_TRAIL_SCANS: usize = 10;
/// A trail of a playback has no gap of more scans than this.
const MAX_JUMP: u64 = 100;
/// The help does not scroll farther than its last lines on the smallest screen.
const MAX_HELP_SCROLL: u16 = 24;
/// A message is shown for this time.
const MESSAGE_TIME: Duration = Duration::from_secs(6);

/// All that is on the screen.
#[derive(Debug)]
pub(crate) struct Model {
    /// The port as the user named it.
    pub(crate) port: String,
    pub(crate) version: Version,
    pub(crate) rate: Rate,
    /// The requested window. The scan shown may be of the previous one.
    pub(crate) window: Window,
    pub(crate) scan: Option<Scan>,
    pub(crate) paused: bool,
    /// The first line of the help that is shown, while it is.
    pub(crate) help: Option<u16>,
    /// Older scans, the oldest one first.
    pub(crate) trail: VecDeque<Scan>,
    pub(crate) shows_trail: bool,
    /// Set unless the laser was switched off here: the sensor does not report it.
    pub(crate) laser: bool,
    pub(crate) state: State,
    pub(crate) stats: Stats,
    /// The place in the recording; `None` for a sensor.
    pub(crate) playback: Option<PlaybackStatus>,
    /// The current time, for everything that is shown in seconds.
    pub(crate) now: Instant,
    message: Option<(Instant, String)>,
    zoom: usize,
}

/// A request of a key to the sensor or the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Action {
    Quit,
    Watch(Window),
    Laser(bool),
    Playback(PlaybackCommand),
    Save,
}

impl Model {
    /// Creates a radar without a scan.
    pub(crate) fn new(port: String, version: Version, window: Window, rate: Rate) -> Self {
        Self {
            port,
            version,
            rate,
            window,
            scan: None,
            paused: false,
            help: None,
            trail: VecDeque::new(),
            shows_trail: false,
            laser: true,
            state: State::Closed { error: None },
            stats: Stats::default(),
            playback: None,
            now: Instant::now(),
            message: None,
            zoom: 0,
        }
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
            KeyCode::Char('l') => return Some(Action::Laser(!self.laser)),
            KeyCode::Char('s') => return Some(Action::Save),
            KeyCode::Char('w') => return self.watch(next_window(self.window)),
            KeyCode::Char('c') => return self.watch(next_cluster(self.window)),
            KeyCode::Left => return self.watch(moved(self.window, ARROW_STEPS, ARROW_STEPS)),
            KeyCode::Right => return self.watch(moved(self.window, -ARROW_STEPS, -ARROW_STEPS)),
            KeyCode::Up => return self.watch(moved(self.window, -ARROW_STEPS, ARROW_STEPS)),
            KeyCode::Down => return self.watch(moved(self.window, ARROW_STEPS, -ARROW_STEPS)),
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

    fn watch(&mut self, window: Window) -> Option<Action> {
        (window != self.window).then(|| {
            self.window = window;
            // A new window is to be seen.
            self.paused = false;
            Action::Watch(window)
        })
    }

    /// Shows a new scan, unless the picture is paused.
    pub(crate) fn scanned(&mut self, scan: Scan) {
        if self.paused {
            return;
        }
        // Those of another window would not fit the picture.
        self.trail.retain(|older| older.window() == scan.window());
        if let Some(older) = self.scan.replace(scan) {
            self.trail.push_back(older);
        }
        while self.trail.len() > MAX_TRAIL_SCANS {
            self.trail.pop_front();
        }
    }

    /// Shows the place of the playback, and its scan through the current window.
    pub(crate) fn moved(&mut self, scan: &Scan, status: PlaybackStatus) {
        self.playback = Some(status);
        let scan = seen_through(scan, self.window);
        let before = self.scan.as_ref().map(|before| (before.sequence(), before.window()));
        if before == Some((scan.sequence(), scan.window())) {
            return;
        }
        // After a jump they would be no trail.
        let near = scan.sequence().saturating_sub(MAX_JUMP)..scan.sequence();
        let shown = self.trail.iter().chain(&self.scan);
        if !shown.into_iter().all(|older| near.contains(&older.sequence())) {
            self.trail.clear();
            self.scan = None;
        }
        self.scanned(scan);
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

    /// Returns the figures of the schedule that is shown.
    pub(crate) fn pace(&self) -> Option<&ScheduleStats> {
        self.stats.schedules.iter().find(|schedule| schedule.window == self.window)
    }

    /// Returns whether the picture shows what it is to show: the present, or a place
    /// in a recording.
    pub(crate) fn is_live(&self) -> bool {
        let is_connected = matches!(self.state, State::Connected { .. });
        self.playback.is_some() || (is_connected && self.laser && !self.paused)
    }
}

/// Returns the place of the help after a key: scrolled, or `None` when it closes.
fn scrolled(help: Option<u16>, code: KeyCode) -> Option<u16> {
    match code {
        KeyCode::Down => help.map(|line| (line + 1).min(MAX_HELP_SCROLL)),
        KeyCode::Up => help.map(|line| line.saturating_sub(1)),
        _ => None,
    }
}

/// From the windows that people want most the next one, at the same cluster
/// count.
fn next_window(window: Window) -> Window {
    let degrees = |most: f64| Window::degrees(-most..=most).unwrap_or(Window::DETECTION);
    let windows = [Window::DETECTION, degrees(90.0), degrees(45.0), Window::FULL];
    let same = |other: &Window| (other.start(), other.end()) == (window.start(), window.end());
    // From any other window, and from the last of them, to the first.
    let next = windows.iter().skip_while(|other| !same(other)).nth(1);
    let next = next.copied().unwrap_or(Window::DETECTION);
    next.with_cluster_count(window.cluster_count()).unwrap_or(next)
}

fn next_cluster(window: Window) -> Window {
    let next = CLUSTERS.into_iter().find(|count| *count > window.cluster_count()).unwrap_or(1);
    window.with_cluster_count(next).unwrap_or(window)
}

/// The window with its two ends moved by so many steps, as far as the sensor
/// can look. It keeps its width when both move the same way.
fn moved(window: Window, start: i32, end: i32) -> Window {
    let seen = Window::DETECTION;
    let (least, most) = (i32::from(seen.start().number()), i32::from(seen.end().number()));
    let from = i32::from(window.start().number());
    let to = i32::from(window.end().number());
    let (from, to) = if start == end {
        let by = if start > 0 {
            start.min((most - to).max(0))
        } else {
            start.max((least - from).min(0))
        };
        (from + by, to + by)
    } else if end > 0 {
        ((from + start).max(least.min(from)), (to + end).min(most.max(to)))
    } else if to - from + 1 + end - start < MIN_STEPS {
        (from, to)
    } else {
        (from + start, to + end)
    };
    let steps = u16::try_from(from).ok().zip(u16::try_from(to).ok());
    steps
        .and_then(|(from, to)| Window::new(from..=to).ok())
        .and_then(|moved| moved.with_cluster_count(window.cluster_count()).ok())
        .unwrap_or(window)
}
