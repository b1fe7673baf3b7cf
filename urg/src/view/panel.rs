//! Panel with the figures of one sensor, beside its picture.

use ratatui::style::Style;
use ratatui::text::{Line, Span};
use tokio_scip::protocol::Protocol;
use tokio_scip::{Point, Scan, State};

use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::symbols::mark;
use crate::format::time::{self, clock};
use crate::playback::PlaybackStatus;
use crate::plot::colours;
use crate::plot::missing::MissingKind;
use crate::plot::summary::ScanSummary;

/// Builds the panel of a single sensor, in at most `rows` lines if possible.
pub(crate) fn lines(model: &Model, palette: Palette, rows: u16) -> Vec<Line<'static>> {
    let Some(layer) = model.selected() else { return Vec::new() };
    let panel = Panel { layer, palette };
    let mut lines = match model.playback {
        Some(status) => panel.playback(status),
        None => panel.link(model),
    };
    lines.extend(panel.window());
    let mut figures = Vec::new();
    if model.playback.is_none() {
        figures.extend(panel.pace());
    }
    figures.push(Line::default());
    figures.extend(panel.scan(model.reach()));
    lines.extend(figures.into_iter().map(|line| dimmed_if_old(line, model, layer)));
    lines.push(Line::default());
    lines.extend(panel.colors());
    if lines.len() > usize::from(rows) {
        lines.retain(|line| line.width() > 0);
    }
    lines
}

/// Builds the lines that only the selected of several sensors gets.
pub(crate) fn details(model: &Model, layer: &Layer, palette: Palette) -> Vec<Line<'static>> {
    let panel = Panel { layer, palette };
    let mut lines = vec![Line::styled(format!("of {}:", layer.label()), Palette::quiet())];
    lines.extend(panel.window());
    let figures = panel.latency().into_iter().chain(panel.losses()).chain(panel.missing());
    lines.extend(figures.map(|line| dimmed_if_old(line, model, layer)));
    lines
}

/// Dims a line of figures that are not current.
pub(crate) fn dimmed_if_old(line: Line<'static>, model: &Model, layer: &Layer) -> Line<'static> {
    if model.playback.is_some() || layer.is_connected() {
        return line;
    }
    let spans = line.spans.into_iter().map(|span| Span::styled(span.content, Palette::quiet()));
    Line::from_iter(spans)
}

pub(crate) fn link(model: &Model, layer: &Layer, palette: Palette) -> (String, Style) {
    match &layer.state {
        State::Connecting { .. } => ("looking for it".to_owned(), palette.poor()),
        State::Connected { .. } => ("connected".to_owned(), palette.good()),
        State::Recovering => ("silent".to_owned(), palette.poor()),
        State::Disconnected { since, .. } => {
            let seconds = model.now.saturating_duration_since(*since).as_secs();
            (format!("LOST for {seconds} s"), palette.bad())
        }
        _ => ("closed".to_owned(), palette.bad()),
    }
}

pub(crate) fn nearest(layer: &Layer) -> String {
    let nearest = layer.scan.as_ref().and_then(Scan::nearest);
    let text = |point: Point| format!("{:.3} m at {:.0}°", point.range, point.angle.to_degrees());
    nearest.map_or_else(|| "-".to_owned(), text)
}

struct Panel<'a> {
    layer: &'a Layer,
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

    fn link(&self, model: &Model) -> Vec<Line<'static>> {
        let (link, style) = link(model, self.layer, self.palette);
        let speed = match &self.layer.state {
            State::Connected { .. } if self.layer.stats.baud_rate_disproved => {
                "no baud rate".to_owned()
            }
            State::Connected { baud_rate: Some(speed), .. } => format!("{speed} baud"),
            State::Connected { baud_rate: None, .. } => self.layer.line.to_owned(),
            _ => "-".to_owned(),
        };
        vec![self.styled("link", link, style), self.row("line", speed)]
    }

    fn playback(&self, status: PlaybackStatus) -> Vec<Line<'static>> {
        let (state, style) = match status {
            _ if status.paused => ("paused", self.palette.poor()),
            _ if status.ended => ("at the end", self.palette.poor()),
            _ => ("playing", self.palette.good()),
        };
        let mut lines = vec![
            self.styled("file", state, style),
            self.row("time", format!("{} of {}", clock(status.position), clock(status.length))),
            self.row("scan", format!("{} of {}", status.scan + 1, status.scans)),
            self.row("speed", speed(status)),
        ];
        if let Some(scan) = &self.layer.scan {
            // The stamp is too long for one line of the panel.
            let stamp = time::utc(scan.times().stamp);
            let (date, time) = stamp.split_once(' ').unwrap_or_default();
            lines.push(self.row("stamp", date));
            lines.push(self.row("", time));
        }
        lines
    }

    fn window(&self) -> Vec<Line<'static>> {
        let window = self.layer.shown_window();
        let cluster = match window.cluster_count() {
            1 => String::new(),
            count => format!(" by {count}"),
        };
        let steps = format!("{} to {}{cluster}", window.start(), window.end());
        let [from, to] =
            [window.start(), window.end()].map(|step| self.layer.geometry().degrees(step));
        vec![self.row("steps", steps), self.row("", format!("{from:.1}° to {to:.1}°"))]
    }

    fn pace(&self) -> Vec<Line<'static>> {
        let scans = self.layer.stats.scans.to_string();
        let figures = [self.rate()].into_iter().chain(self.latency());
        figures.chain([self.row("scans", scans)]).chain(self.losses()).collect()
    }

    fn rate(&self) -> Line<'static> {
        let Some(pace) = self.layer.pace() else { return self.row("rate", "-") };
        let of = match pace.rate.period() {
            Some(period) => format!("of {} Hz", (10.0 / period.as_secs_f64()).round() / 10.0),
            None => "Hz (max)".to_owned(),
        };
        let Some(reached) = self.layer.reached() else {
            return self.row("rate", format!("- {of}"));
        };
        let is_reached = pace.rate.is_reached_by(reached);
        let style = if is_reached { Style::new() } else { self.palette.poor() };
        self.styled("rate", format!("{reached:.1} {of}"), style)
    }

    /// Latency of polls. The scans of SCIP 2 are not polled: their statistics have the intervals.
    fn latency(&self) -> Option<Line<'static>> {
        let polled = self.layer.scan.as_ref()?.geometry().protocol() == Protocol::Scip1;
        let latency = Some(self.layer.stats.reply_latency);
        let latency = latency.filter(|latency| polled && latency.count > 0)?;
        let [last, min, max] = [latency.last, latency.min, latency.max].map(|one| one.as_millis());
        Some(self.row("latency", format!("{last} ms ({min} to {max})")))
    }

    /// Counts the scans that did not come, one row per cause, because two causes do not fit in a row.
    fn losses(&self) -> Vec<Line<'static>> {
        let stats = &self.layer.stats;
        let failed = stats.timeouts + stats.malformed.total() + stats.refused;
        let kinds = [
            (stats.timeouts, "unanswered"),
            (stats.malformed.total(), "malformed"),
            (stats.refused, "refused"),
            (stats.lost.saturating_sub(failed), "on the way"),
            (stats.disconnects, "unplugged"),
        ];
        let mut name = "lost";
        let rows = kinds.into_iter().filter(|(count, _)| *count > 0).map(|(count, kind)| {
            self.styled(std::mem::take(&mut name), format!("{count} {kind}"), self.palette.poor())
        });
        let rows: Vec<_> = rows.collect();
        if rows.is_empty() { vec![self.row("lost", "0")] } else { rows }
    }

    /// Figures of the scan, including the number of points beyond `reach` metres.
    fn scan(&self, reach: f64) -> Vec<Line<'static>> {
        let Some(scan) = &self.layer.scan else { return vec![self.row("points", "none yet")] };
        let points = format!("{} of {}", scan.points().count(), scan.len());
        let mut lines = vec![self.row("points", points), self.row("nearest", nearest(self.layer))];
        match scan.points().filter(|point| f64::from(point.range) > reach).count() {
            0 => {}
            count => lines.push(self.row("outside", format!("{count} beyond the rim"))),
        }
        lines.extend(self.missing());
        lines
    }

    /// Counts the directions without a distance, by kind.
    fn missing(&self) -> Vec<Line<'static>> {
        let Some(scan) = &self.layer.scan else { return Vec::new() };
        let summary = ScanSummary::from_scan(scan);
        let mut lines = vec![Line::styled("no distance, at the rim", Palette::quiet())];
        for kind in MissingKind::ALL {
            let style = Style::new().fg(self.palette.missing(kind));
            let text = format!("{} {:<5} {}", mark(kind), kind.name(), summary.count(kind));
            lines.push(Line::styled(text, style));
        }
        lines
    }

    /// Legend of the colours; empty without colours.
    fn colors(&self) -> Vec<Line<'static>> {
        if self.palette == Palette::Plain {
            return Vec::new();
        }
        let (colors, [least, most]) = if self.layer.has_intensities() {
            (self.palette.intensities(), colours::SCALE.map(|end| end.to_string()))
        } else {
            let colors = self.palette.distances();
            let most = colours::width(self.layer.reach.metres) * colors.len() as f64;
            (colors, ["0".to_owned(), format!("{most} m")])
        };
        let mut spans = vec![Span::styled(format!("{least} "), Palette::quiet())];
        spans.extend(colors.map(|color| Span::styled("██", Style::new().fg(color))));
        spans.push(Span::styled(format!(" {most}"), Palette::quiet()));
        vec![Line::from(spans)]
    }
}

fn speed(status: PlaybackStatus) -> String {
    let again = if status.is_looping { ", looping" } else { "" };
    format!("{}x{again}", (status.speed * 100.0).round() / 100.0)
}

/// Draws the position in a recording as a bar of `width` columns.
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

/// Most important figures, for a screen without a panel.
pub(crate) fn brief(layer: &Layer) -> String {
    let noun = if layer.scan.is_some() { " points" } else { "" };
    format!("{}{noun}, {}", points(layer), rate(layer))
}

/// Number of points with a distance, and of all points.
pub(crate) fn points(layer: &Layer) -> String {
    match &layer.scan {
        Some(scan) => format!("{} of {}", scan.points().count(), scan.len()),
        None => "no scan yet".to_owned(),
    }
}

pub(crate) fn rate(layer: &Layer) -> String {
    match layer.reached() {
        Some(rate) => format!("{rate:.1} Hz"),
        None => "- Hz".to_owned(),
    }
}

pub(crate) fn who(layer: &Layer) -> String {
    let mut parts: Vec<_> = layer.name.iter().chain([&layer.port]).cloned().collect();
    if let Some(version) = &layer.version {
        parts.push(format!("{} {}", version.product, version.serial_number));
    }
    parts.join("  ")
}

/// Note in the title while the picture is paused or the recording is at its end.
pub(crate) fn held(model: &Model) -> Option<String> {
    if let Some(status) = model.playback {
        return match status {
            _ if status.paused => Some(format!(" PAUSED at {} ", clock(status.position))),
            _ if status.ended => Some(" END ".to_owned()),
            _ => None,
        };
    }
    let number = model.selected()?.scan.as_ref().map(Scan::sequence)?;
    model.paused.then(|| format!(" PAUSED at scan {number} "))
}
