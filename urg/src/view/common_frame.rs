//! Picture of the common frame: the points of all sensors, each in its sensor's colour, or
//! as its sensor's number without colours. Only the selected sensor shows its sector and
//! missing distances, because several sectors at once would be unreadable.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::canvas::{Canvas, Context};
use tokio_scip::{Scan, Window};

use super::chart::{Chart, GRID, LabelSpace, Margin, TRAIL};
use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::radar::{marks, nearest};
use super::several::sign;
use crate::plot::{self, Anchor, Extent, Place, Sector, pose};

/// Sector of the common frame: a full circle.
const ALL_AROUND: Sector = Sector { from: -std::f64::consts::PI, to: std::f64::consts::PI };
/// Arrows for the direction of a sensor, in eighths of a turn counter-clockwise from ahead.
const ARROWS: [&str; 8] = ["▲", "◤", "◀", "◣", "▼", "◢", "▶", "◥"];

/// Draws all sensors into `area`.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, model: &Model, palette: Palette) {
    let reach = model.reach();
    let extent = extent(model, reach);
    let chart = Chart::new(area, extent, Margin { columns: 2.0, rows: 1.0 });
    let canvas =
        Canvas::default().marker(Marker::Braille).x_bounds(chart.x).y_bounds(chart.y).paint(
            |context| {
                for (number, layer) in in_order(model) {
                    context.layer();
                    points(context, &chart, number, layer, model, palette);
                }
            },
        );
    frame.render_widget(canvas, area);
    let buffer = frame.buffer_mut();
    if palette == Palette::Plain {
        trails(buffer, &chart, model, palette);
    }
    grid(buffer, &chart, model, extent, palette);
    if palette == Palette::Plain && model.has_several() {
        for (number, layer) in in_order(model) {
            numbers(buffer, &chart, number, layer);
        }
    }
    let mut free = LabelSpace::default();
    for (number, layer) in in_order(model).rev() {
        sensor(buffer, &chart, &mut free, number, layer, model, palette);
    }
    if let Some(selected) = model.selected() {
        marks(buffer, &chart, selected, reach, palette);
        nearest(buffer, &chart, &mut free, selected, reach);
    }
    for ring in plot::rings(farthest(extent)) {
        let name = format!("{} m", (ring * 100.0).round() / 100.0);
        let place = Place { right: 0.0, ahead: ring };
        // Otherwise the label takes the colour of a point in its cell.
        let style = Palette::quiet().fg(Color::Reset);
        chart.label(buffer, &mut free, place, Anchor::Middle, &name, style);
    }
}

/// Iterates over layers and their numbers. The selected layer comes last, to be on top.
fn in_order(model: &Model) -> impl DoubleEndedIterator<Item = (usize, &Layer)> {
    let selected = model.selected_number();
    let layers = || model.layers.iter().enumerate();
    let others = layers().filter(move |(number, _)| *number != selected);
    others.chain(layers().filter(move |(number, _)| *number == selected))
}

fn sector_of(layer: &Layer) -> Sector {
    let window: Window = layer.scan.as_ref().map_or(layer.window, Scan::window);
    Sector::of(window)
}

/// Computes the rectangle around the origin that contains all sectors, in metres.
fn extent(model: &Model, reach: f64) -> Extent {
    let mut extent = Extent { left: 0.0, right: 0.0, ahead: 0.0, behind: 0.0 };
    for layer in &model.layers {
        let Sector { from, to } = sector_of(layer);
        let rim = (0..=48).map(|n| from + (to - from) * f64::from(n) / 48.0);
        let rim = rim.map(|angle| layer.place(reach, angle));
        for Place { right, ahead } in rim.chain([layer.place(0.0, 0.0)]) {
            extent.left = extent.left.max(-right);
            extent.right = extent.right.max(right);
            extent.ahead = extent.ahead.max(ahead);
            extent.behind = extent.behind.max(-ahead);
        }
    }
    extent
}

/// Maximum radius of a ring, in metres.
fn farthest(extent: Extent) -> f64 {
    let Extent { left, right, ahead, behind } = extent;
    left.max(right).max(ahead).max(behind)
}

/// Draws rings around the common origin, and the edges of the selected sector.
fn grid(buffer: &mut Buffer, chart: &Chart, model: &Model, extent: Extent, palette: Palette) {
    for ring in plot::rings(farthest(extent)) {
        chart.cells(buffer, ALL_AROUND.arc(ring, 4.0 * chart.dot), GRID, palette.faint());
    }
    let Some(selected) = model.selected() else { return };
    let (sector, reach) = (sector_of(selected), model.reach());
    let spacing = 3.0 * chart.dot;
    let dots = (reach / spacing).min(1000.0) as u32;
    for edge in [sector.from, sector.to] {
        let along = |n| selected.place(f64::from(n) * spacing, edge);
        chart.cells(buffer, (0..=dots).map(along), GRID, palette.faint());
    }
}

/// Draws the trail and the scan of a layer.
fn points(
    context: &mut Context<'_>,
    chart: &Chart,
    number: usize,
    layer: &Layer,
    model: &Model,
    palette: Palette,
) {
    let places = |scan| places(layer, scan);
    let trail = layer.trail.iter().filter(|_| model.shows_trail && palette != Palette::Plain);
    for older in trail {
        chart.dots(context, places(older).into_iter(), palette.faint());
    }
    let Some(scan) = &layer.scan else { return };
    if !model.is_live(layer) {
        chart.dots(context, places(scan).into_iter(), palette.faint());
    } else if model.has_several() {
        chart.dots(context, places(scan).into_iter(), palette.sensor(number));
    } else {
        for (place, point) in places(scan).into_iter().zip(scan.points()) {
            chart.dots(context, std::iter::once(place), palette.distance(point.range.into()));
        }
    }
}

/// Places of a scan's points in the common frame.
fn places(layer: &Layer, scan: &Scan) -> Vec<Place> {
    let points = layer.pose.transform_scan(scan);
    points.map(|point| Place::of(point.x.into(), point.y.into())).collect()
}

/// Draws the trails on a terminal without colours.
fn trails(buffer: &mut Buffer, chart: &Chart, model: &Model, palette: Palette) {
    for layer in model.layers.iter().filter(|_| model.shows_trail) {
        for older in &layer.trail {
            chart.cells(buffer, places(layer, older).into_iter(), TRAIL, palette.faint());
        }
    }
}

/// Writes the sensor's number over each of its points.
fn numbers(buffer: &mut Buffer, chart: &Chart, number: usize, layer: &Layer) {
    let Some(scan) = &layer.scan else { return };
    for place in places(layer, scan) {
        if let Some((column, row)) = chart.cell(place) {
            buffer.set_string(column, row, sign(number), Style::new());
        }
    }
}

/// Writes a sensor's arrow and number at its place, or beside it if the place is taken.
fn sensor(
    buffer: &mut Buffer,
    chart: &Chart,
    free: &mut LabelSpace,
    number: usize,
    layer: &Layer,
    model: &Model,
    palette: Palette,
) {
    let eighths = (pose::yaw(layer.pose) / 45.0).round().rem_euclid(8.0) as usize;
    let arrow = ARROWS.get(eighths).copied().unwrap_or("▲");
    let (text, color) = if model.has_several() {
        (format!("{arrow}{}", sign(number)), palette.sensor(number))
    } else {
        (arrow.to_owned(), palette.distance(f64::MAX))
    };
    let style = Style::new().fg(color).add_modifier(Modifier::BOLD);
    let place = layer.place(0.0, 0.0);
    for (columns, rows) in
        [(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 1.0), (0.0, -1.0), (6.0, 0.0), (-6.0, 0.0)]
    {
        let place = chart.beside(place, columns, rows);
        if chart.label(buffer, free, place, Anchor::Middle, &text, style) {
            return;
        }
    }
}
