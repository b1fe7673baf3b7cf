//! The figures beside the radar.

use ratatui::style::Style;
use ratatui::text::{Line, Span};
use tokio_scip::{Scan, State};

use super::model::Model;
use super::palette::{BAND, Palette};
use super::radar::mark;
use crate::format::time::{self, clock};
use crate::playback::PlaybackStatus;
use crate::plot::missing::MissingKind;
use crate::plot::summary::ScanSummary;
use crate::stream::link;
use crate::stream::rate_watch::ENOUGH;

/// Returns the whole panel, in at most `rows` lines if possible.
pub(crate) fn lines(model: &Model, palette: Palette, rows: u16) -> Vec<Line<'static>> {
    let panel = Panel { model, palette };
    let mut lines = match model.playback {
        Some(status) => panel.playback(status),
        None => panel.link(),
    };
    lines.extend(panel.window());
    if model.playback.is_none() {
        lines.extend(panel.pace());
    }
    lines.push(Line::default());
    lines.extend(panel.scan());
    lines.push(Line::default());
    lines.extend(panel.colors());
    if lines.len() > usize::from(rows) {
        lines.retain(|line| line.width() > 0);
    }
    lines
}

struct Panel<'a> {
    model: &'a Model,
    palette: Palette,
}

impl Panel<'_> {
    fn row(&self, name: &str, value: impl Into<String>) -> Line<'static> {
        self.styled(name, value, Style::new())
    }

    fn styled(&self, name: &str, value: impl Into<String>, style: Style) -> Line<'static> {
        let name = Span::styled(format!("{name:<8}"), Palette::quiet());
        Line::from(vec![name, Span::styled(value.into(), style)])
    }

    fn link(&self) -> Vec<Line<'static>> {
        let (model, palette) = (self.model, self.palette);
        let (link, style) = match &model.state {
            State::Connecting { .. } => ("looking for it".to_owned(), palette.poor()),
            State::Connected { .. } => ("connected".to_owned(), palette.good()),
            State::Recovering => ("silent".to_owned(), palette.poor()),
            State::Disconnected { since, .. } => {
                let seconds = model.now.saturating_duration_since(*since).as_secs();
                (format!("LOST for {seconds} s"), palette.bad())
            }
            _ => ("closed".to_owned(), palette.bad()),
        };
        let speed = match &model.state {
            State::Connected { baud_rate: Some(speed), .. } => format!("{speed} baud"),
            State::Connected { baud_rate: None, .. } => "USB".to_owned(),
            _ => "-".to_owned(),
        };
        let laser = if model.laser {
            self.row("laser", "on")
        } else {
            self.styled("laser", "OFF", palette.poor())
        };
        vec![self.styled("link", link, style), self.row("line", speed), laser]
    }

    /// Returns the place in the recording.
    fn playback(&self, status: PlaybackStatus) -> Vec<Line<'static>> {
        let (state, style) = match status {
            _ if status.paused => ("paused", self.palette.poor()),
            _ if status.ended => ("at its end", self.palette.poor()),
            _ => ("playing", self.palette.good()),
        };
        let mut lines = vec![
            self.styled("file", state, style),
            self.row("time", format!("{} of {}", clock(status.position), clock(status.length))),
            self.row("scan", format!("{} of {}", status.scan + 1, status.scans)),
            self.row("speed", speed(status)),
        ];
        if let Some(scan) = &self.model.scan {
            // In two lines: one is too long for the panel.
            let stamp = time::utc(scan.stamp());
            let (date, time) = stamp.split_once(' ').unwrap_or_default();
            lines.push(self.row("stamp", date));
            lines.push(self.row("", time));
        }
        lines
    }

    fn window(&self) -> Vec<Line<'static>> {
        let window = self.model.window;
        let cluster = match window.cluster_count() {
            1 => String::new(),
            count => format!(" by {count}"),
        };
        let steps = format!("{} to {}{cluster}", window.start(), window.end());
        let angles = format!("{:.1}° to {:.1}°", window.start().degrees(), window.end().degrees());
        vec![self.row("steps", steps), self.row("", angles)]
    }

    fn pace(&self) -> Vec<Line<'static>> {
        let scans = self.model.stats.scans.to_string();
        vec![self.rate(), self.latency(), self.row("scans", scans), self.losses()]
    }

    fn rate(&self) -> Line<'static> {
        let Some(pace) = self.model.pace() else { return self.row("rate", "-") };
        let asked = match pace.asked {
            Some(asked) => format!("of {} Hz", (asked * 10.0).round() / 10.0),
            None => "Hz (max)".to_owned(),
        };
        // Zero until there is something to average.
        if pace.reached <= 0.0 {
            return self.row("rate", format!("- {asked}"));
        }
        let enough = pace.asked.is_none_or(|asked| pace.reached >= ENOUGH * asked);
        let style = if enough { Style::new() } else { self.palette.poor() };
        self.styled("rate", format!("{:.1} {asked}", pace.reached), style)
    }

    fn latency(&self) -> Line<'static> {
        let latency = self.model.stats.reply_latency;
        let text = match latency.count {
            0 => "-".to_owned(),
            _ => format!(
                "{} ms ({} to {})",
                latency.last.as_millis(),
                latency.min.as_millis(),
                latency.max.as_millis()
            ),
        };
        self.row("latency", text)
    }

    /// Returns the polls without a scan, by cause.
    fn losses(&self) -> Line<'static> {
        let stats = &self.model.stats;
        let kinds = [
            (stats.timeouts, "late"),
            (stats.malformed.total(), "damaged"),
            (stats.refused, "refused"),
            (stats.disconnects, "unplugged"),
        ];
        let lost: u64 = kinds.iter().map(|(count, _)| count).sum();
        if lost == 0 {
            return self.row("lost", "0");
        }
        let parts: Vec<_> = kinds
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, name)| format!("{count} {name}"))
            .collect();
        self.styled("lost", parts.join(", "), self.palette.poor())
    }

    fn scan(&self) -> Vec<Line<'static>> {
        let Some(scan) = &self.model.scan else { return vec![self.row("points", "none yet")] };
        let summary = ScanSummary::of(scan);
        let nearest = summary.nearest.map_or_else(
            || "-".to_owned(),
            |point| format!("{:.3} m at {:.0}°", point.range, point.angle.to_degrees()),
        );
        let mut lines = vec![
            self.row("points", format!("{} of {}", summary.distances, summary.points)),
            self.row("nearest", nearest),
        ];
        let hidden = scan.points().filter(|point| f64::from(point.range) > self.model.reach());
        match hidden.count() {
            0 => {}
            count => lines.push(self.row("outside", format!("{count} beyond the rim"))),
        }
        lines.push(Line::styled("no distance, at the rim", Palette::quiet()));
        for kind in MissingKind::ALL {
            let style = Style::new().fg(self.palette.missing(kind));
            let text = format!("{} {:<5} {}", mark(kind), kind.name(), summary.count(kind));
            lines.push(Line::styled(text, style));
        }
        lines
    }

    /// Returns the legend of the colours, where there are any.
    fn colors(&self) -> Vec<Line<'static>> {
        if self.palette == Palette::Plain {
            return Vec::new();
        }
        let colors = self.palette.distances();
        let mut spans = vec![Span::styled("0 ", Palette::quiet())];
        spans.extend(colors.map(|color| Span::styled("██", Style::new().fg(color))));
        let most = BAND * colors.len() as f64;
        spans.push(Span::styled(format!(" {most} m"), Palette::quiet()));
        vec![Line::from(spans)]
    }
}

fn speed(status: PlaybackStatus) -> String {
    let again = if status.is_looping { ", looping" } else { "" };
    format!("{}x{again}", (status.speed * 100.0).round() / 100.0)
}

/// Returns the place in a recording as a line of `width` columns, with a bar.
pub(crate) fn progress(status: PlaybackStatus, width: u16) -> String {
    let mark = if status.paused || status.ended { "❚❚" } else { "▶" };
    let before = format!("{mark:<2} {} ", clock(status.position));
    let after = format!(" {} {}", clock(status.length), speed(status));
    let columns = before.chars().count() + after.chars().count() + 2;
    let columns = usize::from(width).saturating_sub(columns);
    let part = if status.length > 0.0 { status.position / status.length } else { 1.0 };
    let done = ((part * columns as f64) as usize).min(columns.saturating_sub(1));
    let bar = match columns {
        0 => String::new(),
        columns => format!("{}●{}", "━".repeat(done), "─".repeat(columns - 1 - done)),
    };
    format!(" {before}{bar}{after}")
}

/// Returns the most important figures, for a screen without a panel.
pub(crate) fn brief(model: &Model) -> String {
    let points = match &model.scan {
        Some(scan) => format!("{} of {} points", scan.points().count(), scan.len()),
        None => "no scan yet".to_owned(),
    };
    match model.pace().map(|pace| pace.reached).filter(|rate| *rate > 0.0) {
        Some(rate) => format!("{points}, {rate:.1} Hz"),
        None => format!("{points}, - Hz"),
    }
}

/// Returns the trouble with the link, for the message line.
pub(crate) fn trouble(state: &State) -> Option<String> {
    match state {
        State::Disconnected { .. } => {
            link::trouble(state).map(|why| format!("{why}; goes on when the sensor is back"))
        }
        State::Closed { .. } => None,
        state => link::trouble(state),
    }
}

/// Returns the port and the sensor, for the title.
pub(crate) fn who(model: &Model) -> String {
    format!("{}  {} {}", model.port, model.version.product, model.version.serial_number)
}

/// Returns a note for the title while the picture is paused or at its end.
pub(crate) fn held(model: &Model) -> Option<String> {
    if let Some(status) = model.playback {
        return match status {
            _ if status.paused => Some(format!(" PAUSED at {} ", clock(status.position))),
            _ if status.ended => Some(" END ".to_owned()),
            _ => None,
        };
    }
    let number = model.scan.as_ref().map(Scan::sequence)?;
    model.paused.then(|| format!(" PAUSED at scan {number} "))
}
