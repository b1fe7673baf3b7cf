//! Panel for several sensors: a few lines for each, then the details of the selected one.

use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};

use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::panel;
use super::symbols::sign;

/// Longer names are cut, to leave room for the state beside them.
const MAX_NAME_CHARS: usize = 10;

/// Builds the panel: three lines a sensor and the details, or one each if `rows` are too few.
pub(super) fn lines(model: &Model, palette: Palette, rows: u16) -> Vec<Line<'static>> {
    let layers = || model.layers.iter().enumerate();
    let mut lines: Vec<_> =
        layers().flat_map(|(number, layer)| sensor(number, layer, model, palette)).collect();
    if let Some(layer) = model.selected() {
        lines.push(Line::default());
        lines.extend(panel::details(model, layer, palette));
    }
    if lines.len() > usize::from(rows) {
        lines = layers()
            .flat_map(|(number, layer)| sensor(number, layer, model, palette).into_iter().take(1))
            .collect();
    }
    lines
}

/// Builds the lines of a sensor: name and state, rate and points, nearest point.
fn sensor(number: usize, layer: &Layer, model: &Model, palette: Palette) -> [Line<'static>; 3] {
    let (state, style) = panel::link(model, layer, palette);
    let name: String = layer.label().chars().take(MAX_NAME_CHARS).collect();
    let first = vec![
        Span::styled(format!(" {} {name} ", sign(number)), own(number, model, palette)),
        Span::styled(format!(" {state}"), style),
    ];
    let figures = |text| panel::dimmed_if_old(Line::raw(format!("   {text}")), model, layer);
    [
        Line::from(first),
        figures(format!("{}, {}", panel::rate(layer), panel::points(layer))),
        figures(format!("nearest {}", panel::nearest(layer))),
    ]
}

/// Style of a sensor's name and number, reversed for the selected sensor.
fn own(number: usize, model: &Model, palette: Palette) -> Style {
    let style = Style::new().fg(palette.sensor(number)).add_modifier(Modifier::BOLD);
    match number == model.selected_number() {
        true => style.add_modifier(Modifier::REVERSED),
        false => style,
    }
}
