//! Picture of one sensor: sector, rings, points, nearest point, and marks at the rim for
//! directions without a distance.

use std::collections::BTreeMap;

use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::canvas::{Canvas, Context};
use ratatui::{Frame, buffer::Buffer};
use tokio_scip::Scan;

use super::chart::{Chart, GRID, LabelSpace, Margin, TRAIL};
use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use crate::plot::missing::MissingKind;
use crate::plot::{self, Anchor, Extent, Place, Sector};

/// Mark at the rim for a direction without a distance.
pub(crate) fn mark(kind: MissingKind) -> &'static str {
    match kind {
        MissingKind::Far => "^",
        MissingKind::Weak => "~",
        MissingKind::Nothing => "x",
    }
}

/// Draws the selected sensor into `area`.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, model: &Model, palette: Palette) {
    let Some(layer) = model.selected() else { return };
    let sector = Sector::of(layer.scan.as_ref().map_or(layer.window, Scan::window));
    let radar = Radar::new(area, sector, model.reach());
    let chart = &radar.chart;
    let trail = || layer.trail.iter().filter(|_| model.shows_trail);
    let canvas =
        Canvas::default().marker(Marker::Braille).x_bounds(chart.x).y_bounds(chart.y).paint(
            |context| {
                for older in trail().filter(|_| palette != Palette::Plain) {
                    radar.points(context, older, |_| palette.faint());
                }
                if let Some(scan) = &layer.scan {
                    context.layer();
                    radar.points(context, scan, |range| {
                        if model.is_live(layer) { palette.distance(range) } else { palette.faint() }
                    });
                }
            },
        );
    frame.render_widget(canvas, area);
    let buffer = frame.buffer_mut();
    if palette == Palette::Plain {
        for older in trail() {
            let points = older.points().filter(|point| f64::from(point.range) <= radar.reach);
            let places = points.map(|point| plot::place(point.range.into(), point.angle.into()));
            chart.cells(buffer, places, TRAIL, palette.faint());
        }
    }
    radar.grid(buffer, palette.faint());
    if layer.scan.is_some() {
        marks(buffer, chart, layer, model.reach(), palette);
    }
    radar.labels(buffer, layer);
}

/// Marks the cells along the rim whose directions have no distance. Each cell shows its
/// most frequent kind.
pub(super) fn marks(
    buffer: &mut Buffer,
    chart: &Chart,
    layer: &Layer,
    reach: f64,
    palette: Palette,
) {
    let Some(scan) = &layer.scan else { return };
    let mut cells: BTreeMap<_, BTreeMap<MissingKind, usize>> = BTreeMap::new();
    for (angle, measurement) in scan.angles().zip(scan.measurements()) {
        let place = layer.place(reach + 4.0 * chart.dot, angle.into());
        if let (Some(kind), Some(cell)) = (MissingKind::of(measurement), chart.cell(place)) {
            *cells.entry(cell).or_default().entry(kind).or_default() += 1;
        }
    }
    for ((column, row), kinds) in cells {
        if let Some((kind, _)) = kinds.into_iter().max_by_key(|(_, count)| *count) {
            let style = Style::new().fg(palette.missing(kind));
            buffer.set_stringn(column, row, mark(kind), 1, style);
        }
    }
}

/// Sector and its place on the screen.
struct Radar {
    chart: Chart,
    sector: Sector,
    /// Metres to the rim.
    reach: f64,
}

impl Radar {
    fn new(area: Rect, sector: Sector, reach: f64) -> Self {
        // Room for the marks and, on a wide screen, for the labels of the angles.
        let columns = if area.width >= 80 { 8.0 } else { 2.0 };
        let Extent { left, right, ahead, behind } = sector.extent();
        let [left, right, ahead, behind] = [left, right, ahead, behind].map(|side| side * reach);
        let extent = Extent { left, right, ahead, behind };
        let chart = Chart::new(area, extent, Margin { columns, rows: 2.0 });
        Self { chart, sector, reach }
    }

    fn grid(&self, buffer: &mut Buffer, color: Color) {
        let Self { chart, sector, reach } = self;
        for ring in plot::rings(*reach) {
            chart.cells(buffer, sector.arc(ring, 4.0 * chart.dot), GRID, color);
        }
        chart.cells(buffer, sector.arc(*reach, 2.0 * chart.dot), GRID, color);
        for edge in [sector.from, sector.to] {
            let dots = (reach / (3.0 * chart.dot)).min(1000.0) as u32;
            let along = |n| plot::place(f64::from(n) * 3.0 * chart.dot, edge);
            chart.cells(buffer, (0..=dots).map(along), GRID, color);
        }
    }

    fn points(&self, context: &mut Context<'_>, scan: &Scan, color: impl Fn(f64) -> Color) {
        for point in scan.points().filter(|point| f64::from(point.range) <= self.reach) {
            let place = plot::place(point.range.into(), point.angle.into());
            self.chart.dots(context, std::iter::once(place), color(point.range.into()));
        }
    }

    /// Labels the sensor, the nearest point, the rings and the angles.
    fn labels(&self, buffer: &mut Buffer, layer: &Layer) {
        let Self { chart, sector, reach } = self;
        let style = Palette::quiet();
        let mut free = LabelSpace::default();
        let origin = Place { right: 0.0, ahead: 0.0 };
        chart.label(buffer, &mut free, origin, Anchor::Middle, "▲", style);
        nearest(buffer, chart, &mut free, layer, *reach);
        for ring in plot::rings(*reach) {
            let (place, anchor) = sector.beside(ring, 4.0 * chart.dot);
            // Rounded, because 3 * 0.1 is 0.30000000000000004.
            let name = format!("{} m", (ring * 100.0).round() / 100.0);
            chart.label(buffer, &mut free, place, anchor, &name, style);
        }
        for degrees in sector.directions() {
            let angle = f64::from(degrees).to_radians();
            let anchor = match degrees {
                -150..=-15 => Anchor::Start,
                15..=150 => Anchor::End,
                _ => Anchor::Middle,
            };
            // Outside the marks. A cell is twice as high as it is wide.
            let (sin, cos) = angle.sin_cos();
            let rim = plot::place(*reach, angle);
            let place = Place {
                right: rim.right - 6.0 * chart.dot * sin,
                ahead: rim.ahead + 8.0 * chart.dot * cos,
            };
            chart.label(buffer, &mut free, place, anchor, &format!("{degrees}°"), style);
        }
    }
}

/// Circles the nearest point of a layer, as the web page does.
pub(super) fn nearest(
    buffer: &mut Buffer,
    chart: &Chart,
    free: &mut LabelSpace,
    layer: &Layer,
    reach: f64,
) {
    let nearest = layer.scan.as_ref().and_then(Scan::nearest);
    let Some(point) = nearest.filter(|point| f64::from(point.range) <= reach) else { return };
    let place = layer.place(point.range.into(), point.angle.into());
    let style = Style::new().add_modifier(Modifier::BOLD);
    chart.label(buffer, free, place, Anchor::Middle, "○", style);
}
