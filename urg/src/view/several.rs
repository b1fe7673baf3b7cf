//! Panel for several sensors: a few lines for each, then the details of the selected
//! sensor. When rows run out, it drops the nearest points first, then the rates, and
//! finally the details.

use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};

use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::panel;
use super::symbols::sign;

/// Longer names are cut, to leave room for the state beside them.
const MAX_NAME_CHARS: usize = 10;

/// Builds the panel, in at most `rows` lines if possible.
pub(super) fn lines(model: &Model, palette: Palette, rows: u16) -> Vec<Line<'static>> {
    let mut details = vec![Line::default()];
    details.extend(
        model.selected().into_iter().flat_map(|layer| panel::details(model, layer, palette)),
    );
    let layers = || model.layers.iter().enumerate();
    let with_lines = |most| -> Vec<_> {
        layers().flat_map(|(number, layer)| sensor(number, layer, model, palette, most)).collect()
    };
    for (most, has_details) in [(3, true), (1, true), (2, false)] {
        let mut lines = with_lines(most);
        if has_details {
            lines.extend(details.clone());
        }
        if lines.len() <= rows.into() {
            return lines;
        }
    }
    with_lines(1)
}

/// Builds the first `most` lines of a sensor: name and state, rate and points, nearest
/// point.
fn sensor(
    number: usize,
    layer: &Layer,
    model: &Model,
    palette: Palette,
    most: usize,
) -> Vec<Line<'static>> {
    let (state, style) = panel::link(model, layer, palette);
    let name: String = layer.label().chars().take(MAX_NAME_CHARS).collect();
    let name = format!(" {} {name} ", sign(number));
    let first = vec![
        Span::styled(name, own(number, model, palette)),
        Span::styled(format!(" {state}"), style),
    ];
    let figures = |text| panel::dimmed_if_old(Line::raw(format!("   {text}")), model, layer);
    let mut lines = vec![
        Line::from(first),
        figures(format!("{}, {}", panel::rate(layer), panel::points(layer))),
        figures(format!("nearest {}", panel::nearest(layer))),
    ];
    lines.truncate(most);
    lines
}

/// Style of a sensor's name and number, reversed for the selected sensor.
fn own(number: usize, model: &Model, palette: Palette) -> Style {
    let style = Style::new().fg(palette.sensor(number)).add_modifier(Modifier::BOLD);
    match number == model.selected_number() {
        true => style.add_modifier(Modifier::REVERSED),
        false => style,
    }
}
