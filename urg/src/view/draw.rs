//! Layout of the screen: title, radar, figures beside it, messages, keys, and the help on top.

use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, Clear, Paragraph};
use tokio_scip::State;

use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::symbols::sign;
use super::{help, panel, radar, several};
use crate::stream::health;

/// Minimum width and height. A smaller terminal only shows a message.
const MIN_SIZE: (u16, u16) = (30, 10);
/// Minimum width for a panel beside the picture.
const WITH_PANEL: u16 = 64;

/// Draws the whole screen. Returns the first visible line of the help; `None` while the help is closed.
pub(crate) fn draw(frame: &mut Frame<'_>, model: &Model, palette: Palette) -> Option<u16> {
    let area = frame.area();
    let (width, height) = MIN_SIZE;
    if area.width < width || area.height < height {
        let text = format!("too small:\n{width}x{height} is\nthe least");
        frame.render_widget(Paragraph::new(text), area);
        return model.help;
    }
    let rows =
        [Constraint::Length(1), Constraint::Min(0), Constraint::Length(1), Constraint::Length(1)];
    let [title, body, news, keys] = Layout::vertical(rows).areas(area);
    frame.render_widget(Paragraph::new(title_line(model)).style(Palette::bar()), title);
    if let Some(held) = panel::held(model) {
        frame.render_widget(
            Line::raw(held).alignment(Alignment::Right).style(Palette::bar()),
            title,
        );
    }
    if body.width >= WITH_PANEL {
        let wide = if body.width >= 120 { 36 } else { 28 };
        let columns = [Constraint::Min(0), Constraint::Length(wide)];
        let [plot, figures] = Layout::horizontal(columns).areas(body);
        radar::draw(frame, plot, model, palette);
        let figures = Rect { x: figures.x + 1, width: figures.width - 1, ..figures };
        let lines = match model.has_several() {
            true => several::lines(model, palette, figures.height),
            false => panel::lines(model, palette, figures.height),
        };
        frame.render_widget(Paragraph::new(lines), figures);
    } else {
        radar::draw(frame, body, model, palette);
    }
    message(frame, news, model, palette);
    frame.render_widget(help::key_line(keys.width, model), keys);
    model.help.map(|scroll| draw_help(frame, body, scroll, &help::text(model)))
}

fn title_line(model: &Model) -> String {
    let who = model.selected().map(panel::who).unwrap_or_default();
    match model.has_several() {
        true => format!(" urg view  {} {who}", sign(model.selected_number())),
        false => format!(" urg view  {who}"),
    }
}

/// Draws the latest message, or trouble, or the main figures. A long message covers part of the plot.
fn message(frame: &mut Frame<'_>, area: Rect, model: &Model, palette: Palette) {
    let (text, style) = if let Some(message) = model.message() {
        (message.to_owned(), palette.poor())
    } else if let Some(trouble) = trouble(model) {
        (trouble, palette.bad().add_modifier(Modifier::BOLD))
    } else if let Some(status) = model.playback {
        frame.render_widget(Line::raw(panel::progress(status, area.width)), area);
        return;
    } else if let Some(layer) = model.selected().filter(|_| area.width < WITH_PANEL) {
        (panel::brief(layer), Style::new())
    } else {
        return;
    };
    let lines = textwrap::wrap(&text, usize::from(area.width.saturating_sub(2)));
    let lines: Vec<_> = lines.iter().map(|line| Line::raw(format!(" {line}"))).collect();
    // Keep the title and the line of keys visible.
    let rows = (lines.len() as u16).clamp(1, area.y.max(1));
    let area = Rect { y: area.y + 1 - rows, height: rows, ..area };
    frame.render_widget(Clear, area);
    frame.render_widget(Paragraph::new(lines).style(style), area);
}

/// Trouble of the selected sensor, or else of the first sensor in trouble.
fn trouble(model: &Model) -> Option<String> {
    if model.playback.is_some() {
        return None;
    }
    let of = |layer: &Layer| {
        let trouble = health::trouble(&layer.state)?
            + match &layer.state {
                State::Disconnected { .. } => "; continues when the sensor is back",
                // The other sensors keep the program running.
                State::Closed { error: Some(_) } => "; with --wait urg waits for it",
                _ => "",
            };
        Some(match model.has_several() {
            true => format!("{}: {trouble}", layer.label()),
            false => trouble,
        })
    };
    model.selected().and_then(of).or_else(|| model.layers.iter().find_map(of))
}

/// Draws the help from line `scroll`, but never past its end. Returns the first visible line.
fn draw_help(frame: &mut Frame<'_>, area: Rect, scroll: u16, text: &str) -> u16 {
    let block = Block::bordered().title(help::TITLE).border_style(Palette::quiet());
    let columns = text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    let width = (columns as u16 + 4).min(area.width);
    let lines = help::folded(text, width.saturating_sub(2).into());
    let rows = lines.len() as u16;
    let height = (rows + 2).min(area.height);
    let area = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    let scroll = scroll.min((rows + 2).saturating_sub(height));
    let is_title = |line: &str| line.ends_with(':');
    let lines = lines.into_iter().map(|line| match is_title(&line) {
        true => Line::styled(line, Style::new().add_modifier(Modifier::BOLD)),
        false => Line::raw(line),
    });
    let lines: Vec<_> = lines.collect();
    frame.render_widget(Clear, area);
    frame.render_widget(Paragraph::new(lines).scroll((scroll, 0)).block(block), area);
    scroll
}
