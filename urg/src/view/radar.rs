//! Picture of the sensors: rings, points, nearest point, and marks of missing points at the rim.
//!
//! A single sensor without a pose has its sector and the directions around it. Otherwise the
//! picture shows the common frame: each sensor's points have its colour. Only the selected sensor shows its edges and missing distances, because
//! several sectors at once would be unreadable.

use std::collections::BTreeMap;

use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::canvas::{Canvas, Context};
use ratatui::{Frame, buffer::Buffer};
use tokio_scip::{Point, Scan};

use super::chart::{Chart, LabelSpace};
use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::symbols::{GRID, mark, sign};
use crate::plot::colours;
use crate::plot::missing::MissingKind;
use crate::plot::{self, Anchor, Extent, Place, Sector, pose};

/// Sector of the common frame: a full circle.
const ALL_AROUND: Sector = Sector { from: -std::f64::consts::PI, to: std::f64::consts::PI };
/// Arrows for the direction of a sensor, in eighths of a turn counter-clockwise from ahead.
const ARROWS: [&str; 8] = ["▲", "◤", "◀", "◣", "▼", "◢", "▶", "◥"];

pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, model: &Model, palette: Palette) {
    let Some(selected) = model.selected() else { return };
    let radar = Radar::new(area, model, selected, palette);
    let chart = &radar.chart;
    let canvas = Canvas::default().marker(Marker::Braille).x_bounds(chart.x).y_bounds(chart.y);
    frame.render_widget(canvas.paint(|context| radar.points(context)), area);
    let buffer = frame.buffer_mut();
    radar.grid(buffer);
    radar.marks(buffer);
    radar.labels(buffer);
}

/// Sensors and their place on the screen.
struct Radar<'a> {
    model: &'a Model,
    selected: &'a Layer,
    palette: Palette,
    chart: Chart,
    /// Directions that the rings cover.
    sector: Sector,
    /// Metres to the rim of the selected sensor.
    reach: f64,
    /// Maximum radius of a ring, in metres.
    farthest: f64,
}

impl<'a> Radar<'a> {
    fn new(area: Rect, model: &'a Model, selected: &'a Layer, palette: Palette) -> Self {
        let reach = model.reach_of(selected);
        let (sector, extent, margin) = if model.is_common_frame() {
            (ALL_AROUND, extent(model), (2.0, 1.0))
        } else {
            let sector = sector_of(selected);
            let Extent { left, right, ahead, behind } = sector.extent();
            let sides = [left, right, ahead, behind].map(|side| side * reach);
            let [left, right, ahead, behind] = sides;
            // Room for the marks and, on a wide screen, for the labels of the angles.
            let columns = if area.width >= 80 { 8.0 } else { 2.0 };
            (sector, Extent { left, right, ahead, behind }, (columns, 2.0))
        };
        let farthest = match model.is_common_frame() {
            true => extent.left.max(extent.right).max(extent.ahead).max(extent.behind),
            false => reach,
        };
        let chart = Chart::new(area, extent, margin);
        Self { model, selected, palette, chart, sector, reach, farthest }
    }

    /// Iterates over layers and their numbers. The selected layer comes last, to be on top.
    fn layers(&self) -> impl DoubleEndedIterator<Item = (usize, &'a Layer)> {
        let (model, selected) = (self.model, self.model.selected_number());
        let layers = || model.layers.iter().enumerate();
        let others = layers().filter(move |(number, _)| *number != selected);
        others.chain(layers().filter(move |(number, _)| *number == selected))
    }

    /// Iterates over the points of a scan, each with its shade. The picture of a single sensor ends
    /// at the rim. Strong points come last, because a cell has the colour of its last point.
    fn shaded(&self, scan: &Scan) -> impl Iterator<Item = (Point, Option<usize>)> {
        let rim = if self.model.is_common_frame() { f64::INFINITY } else { self.reach };
        let points = plot::points(scan).filter(|(point, _)| f64::from(point.range) <= rim);
        let mut points: Vec<_> = points.collect();
        points.sort_by_key(|(_, shade)| *shade);
        points.into_iter()
    }

    fn points(&self, context: &mut Context<'_>) {
        for (number, layer) in self.layers() {
            context.layer();
            for (point, shade) in layer.scan.iter().flat_map(|scan| self.shaded(scan)) {
                let range = point.range.into();
                let color = match shade {
                    _ if !self.model.is_live(layer) => self.palette.faint(),
                    _ if self.model.has_several() => self.palette.sensor_point(number, shade),
                    Some(shade) => self.palette.intensity(shade),
                    None => self.palette.distance(range, colours::width(layer.reach.metres)),
                };
                self.chart.dot(context, layer.place(range, point.angle.into()), color);
            }
        }
    }

    /// Draws the rings, and the rim and the edges of the selected sector.
    fn grid(&self, buffer: &mut Buffer) {
        let Self { chart, sector, reach, .. } = self;
        let color = self.palette.faint();
        for ring in plot::rings(self.farthest) {
            chart.cells(buffer, sector.arc(ring, 4.0 * chart.dot), GRID, color);
        }
        if !self.model.is_common_frame() {
            chart.cells(buffer, sector.arc(*reach, 2.0 * chart.dot), GRID, color);
        }
        let spacing = 3.0 * chart.dot;
        let dots = (reach / spacing).min(1000.0) as u32;
        let Sector { from, to } = sector_of(self.selected);
        for edge in [from, to] {
            let along = |n| self.selected.place(f64::from(n) * spacing, edge);
            chart.cells(buffer, (0..=dots).map(along), GRID, color);
        }
    }

    /// Marks the cells along the selected sensor's rim whose directions have no distance. Each
    /// cell shows its most frequent kind.
    fn marks(&self, buffer: &mut Buffer) {
        let Some(scan) = &self.selected.scan else { return };
        let mut cells: BTreeMap<_, BTreeMap<MissingKind, usize>> = BTreeMap::new();
        for ray in scan.rays() {
            let place = self.selected.place(self.reach + 4.0 * self.chart.dot, ray.angle.into());
            let kind = MissingKind::from_measurement(ray.measurement);
            if let Some((cell, kind)) = self.chart.cell(place).zip(kind) {
                *cells.entry(cell).or_default().entry(kind).or_default() += 1;
            }
        }
        for ((column, row), kinds) in cells {
            if let Some((kind, _)) = kinds.into_iter().max_by_key(|(_, count)| *count) {
                let style = Style::new().fg(self.palette.missing(kind));
                buffer.set_stringn(column, row, mark(kind), 1, style);
            }
        }
    }

    fn labels(&self, buffer: &mut Buffer) {
        let Self { chart, sector, reach, .. } = self;
        let mut free = LabelSpace::default();
        for (number, layer) in self.layers().rev() {
            self.sensor(buffer, &mut free, number, layer);
        }
        self.nearest(buffer, &mut free);
        // Otherwise the label takes the colour of a point in its cell.
        let style = Palette::quiet().fg(Color::Reset);
        for ring in plot::rings(self.farthest) {
            let (place, anchor) = match self.model.is_common_frame() {
                true => (Place { right: 0.0, ahead: ring }, Anchor::Middle),
                false => sector.beside(ring, 4.0 * chart.dot),
            };
            // Rounded, because 3 * 0.1 is 0.30000000000000004.
            let name = format!("{} m", (ring * 100.0).round() / 100.0);
            chart.label(buffer, &mut free, place, anchor, &name, style);
        }
        if self.model.is_common_frame() {
            return;
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

    /// Writes a sensor's arrow, and its number among several, at its place or beside it.
    fn sensor(&self, buffer: &mut Buffer, free: &mut LabelSpace, number: usize, layer: &Layer) {
        let eighths = (pose::yaw(layer.pose) / 45.0).round().rem_euclid(8.0) as usize;
        let arrow = ARROWS.get(eighths).copied().unwrap_or("▲");
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let (text, style) = if self.model.has_several() {
            (format!("{arrow}{}", sign(number)), bold.fg(self.palette.sensor(number)))
        } else {
            // Otherwise the arrow takes the colour of a point in its cell.
            (arrow.to_owned(), bold.fg(Color::Reset))
        };
        let place = layer.place(0.0, 0.0);
        for (columns, rows) in
            [(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 1.0), (0.0, -1.0), (6.0, 0.0), (-6.0, 0.0)]
        {
            let place = self.chart.beside(place, columns, rows);
            if self.chart.label(buffer, free, place, Anchor::Middle, &text, style) {
                return;
            }
        }
    }

    /// Circles the selected sensor's nearest point, as the web page does.
    fn nearest(&self, buffer: &mut Buffer, free: &mut LabelSpace) {
        let nearest = self.selected.scan.as_ref().and_then(Scan::nearest);
        let Some(point) = nearest.filter(|point| f64::from(point.range) <= self.reach) else {
            return;
        };
        let place = self.selected.place(point.range.into(), point.angle.into());
        let style = Style::new().add_modifier(Modifier::BOLD);
        self.chart.label(buffer, free, place, Anchor::Middle, "○", style);
    }
}

/// Sector of the shown scan, or else of the requested window.
fn sector_of(layer: &Layer) -> Sector {
    Sector::from_window(layer.shown_window(), layer.geometry())
}

/// Computes the rectangle around the origin that contains all sectors, in metres.
fn extent(model: &Model) -> Extent {
    let mut extent = Extent { left: 0.0, right: 0.0, ahead: 0.0, behind: 0.0 };
    for layer in &model.layers {
        let (reach, Sector { from, to }) = (model.reach_of(layer), sector_of(layer));
        let rim = (0..=48).map(|n| from + (to - from) * f64::from(n) / 48.0);
        rim.for_each(|angle| extent.include(layer.place(reach, angle)));
        extent.include(layer.place(0.0, 0.0));
    }
    extent
}
