//! The radar itself: sector, rings, points, and marks at the rim for directions
//! without a distance.

use std::collections::BTreeMap;

use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::Span;
use ratatui::widgets::canvas::{Canvas, Context, Points};
use ratatui::{Frame, buffer::Buffer};
use tokio_scip::Scan;

use super::model::Model;
use super::palette::Palette;
use crate::plot::missing::MissingKind;
use crate::plot::{self, Anchor, Place, Sector};

/// Braille has so many dots in a cell.
const ACROSS: f64 = 2.0;
const DOWN: f64 = 4.0;

/// Returns the mark of a direction at the rim.
pub(crate) fn mark(kind: MissingKind) -> &'static str {
    match kind {
        MissingKind::Far => "^",
        MissingKind::Weak => "~",
        MissingKind::Nothing => "x",
    }
}

/// Draws the radar into `area`.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, model: &Model, palette: Palette) {
    let window = model.scan.as_ref().map_or(model.window, Scan::window);
    let chart = Chart::new(area, Sector::of(window), model.reach());
    let canvas =
        Canvas::default().marker(Marker::Braille).x_bounds(chart.x).y_bounds(chart.y).paint(
            |context| {
                chart.grid(context, palette.faint());
                for older in model.trail.iter().filter(|_| model.shows_trail) {
                    chart.points(context, older, |_| palette.faint());
                }
                if let Some(scan) = &model.scan {
                    context.layer();
                    chart.points(context, scan, |range| {
                        if model.is_live() { palette.distance(range) } else { palette.faint() }
                    });
                }
            },
        );
    frame.render_widget(canvas, area);
    let buffer = frame.buffer_mut();
    if let Some(scan) = &model.scan {
        chart.marks(buffer, scan, palette);
    }
    chart.labels(buffer, Palette::quiet());
}

/// The place of the plot in its area.
struct Chart {
    area: Rect,
    sector: Sector,
    /// Metres to the rim.
    reach: f64,
    /// Metres from one dot to the next.
    dot: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Chart {
    fn new(area: Rect, sector: Sector, reach: f64) -> Self {
        let (columns, rows) = (f64::from(area.width), f64::from(area.height));
        // Room for the marks and, where there is some, for the angles' names.
        let beside = if area.width >= 80 { 8.0 } else { 2.0 };
        let extent = sector.extent();
        let across = (columns - 2.0 * beside).max(1.0) * ACROSS;
        let down = (rows - 4.0).max(1.0) * DOWN;
        let dot = (reach * (extent.left + extent.right) / across)
            .max(reach * (extent.ahead + extent.behind) / down);
        let middle = |low: f64, high: f64, dots: f64| {
            let (middle, half) = ((high + low) * reach / 2.0, (dots - 1.0) * dot / 2.0);
            [middle - half, middle + half]
        };
        Self {
            area,
            sector,
            reach,
            dot,
            x: middle(-extent.left, extent.right, columns * ACROSS),
            y: middle(-extent.behind, extent.ahead, rows * DOWN),
        }
    }

    fn grid(&self, context: &mut Context<'_>, color: Color) {
        // Rings are sparse, so that points show among them without colours too.
        for ring in plot::rings(self.reach) {
            self.line(context, self.sector.arc(ring, 4.0 * self.dot), color);
        }
        self.line(context, self.sector.arc(self.reach, 2.0 * self.dot), color);
        for edge in [self.sector.from, self.sector.to] {
            let dots = (self.reach / (3.0 * self.dot)).min(1000.0) as u32;
            let along = |n| plot::place(f64::from(n) * 3.0 * self.dot, edge);
            self.line(context, (0..=dots).map(along), color);
        }
    }

    fn line(&self, context: &mut Context<'_>, places: impl Iterator<Item = Place>, color: Color) {
        let coords: Vec<_> = places.map(|place| (place.right, place.ahead)).collect();
        context.draw(&Points { coords: &coords, color });
    }

    fn points(&self, context: &mut Context<'_>, scan: &Scan, color: impl Fn(f64) -> Color) {
        for point in scan.points().filter(|point| f64::from(point.range) <= self.reach) {
            // y is to the left.
            let coords = [(-f64::from(point.y), f64::from(point.x))];
            context.draw(&Points { coords: &coords, color: color(point.range.into()) });
        }
    }

    /// A mark for each cell along the rim in which directions have no distance:
    /// that of the kind that most of them are of.
    fn marks(&self, buffer: &mut Buffer, scan: &Scan, palette: Palette) {
        let mut cells: BTreeMap<_, BTreeMap<MissingKind, usize>> = BTreeMap::new();
        for (angle, measurement) in scan.angles().zip(scan.measurements()) {
            let place = plot::place(self.reach + 4.0 * self.dot, angle.into());
            if let (Some(kind), Some(cell)) = (MissingKind::of(measurement), self.cell(place)) {
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

    /// The sensor, the ranges beside the sector, and the angles around it.
    fn labels(&self, buffer: &mut Buffer, style: Style) {
        let mut free = LabelSpace::default();
        let origin = Place { right: 0.0, ahead: 0.0 };
        self.label(buffer, &mut free, origin, Anchor::Middle, "▲", style);
        for ring in plot::rings(self.reach) {
            let (place, anchor) = self.sector.beside(ring, 4.0 * self.dot);
            // Without what is left of a decimal fraction in binary.
            let name = format!("{} m", (ring * 100.0).round() / 100.0);
            self.label(buffer, &mut free, place, anchor, &name, style);
        }
        for degrees in self.sector.directions() {
            let angle = f64::from(degrees).to_radians();
            let anchor = match degrees {
                -150..=-15 => Anchor::Start,
                15..=150 => Anchor::End,
                _ => Anchor::Middle,
            };
            // Outside of the marks; a cell is twice as high as it is wide.
            let (sin, cos) = angle.sin_cos();
            let rim = plot::place(self.reach, angle);
            let place = Place {
                right: rim.right - 6.0 * self.dot * sin,
                ahead: rim.ahead + 8.0 * self.dot * cos,
            };
            self.label(buffer, &mut free, place, anchor, &format!("{degrees}°"), style);
        }
    }

    /// Writes `text` where it fits whole and hides no other.
    fn label(
        &self,
        buffer: &mut Buffer,
        free: &mut LabelSpace,
        place: Place,
        anchor: Anchor,
        text: &str,
        style: Style,
    ) {
        let Some((column, row)) = self.cell(place) else { return };
        let width = Span::raw(text).width() as u16;
        let column = match anchor {
            Anchor::Start => Some(column),
            Anchor::Middle => column.checked_sub(width / 2),
            Anchor::End => (column + 1).checked_sub(width),
        };
        let Some(column) = column
            .filter(|column| *column >= self.area.left() && column + width <= self.area.right())
        else {
            return;
        };
        if free.take(row, column, width) {
            buffer.set_string(column, row, text, style);
        }
    }

    /// The cell that a place is in, if it is in sight.
    fn cell(&self, place: Place) -> Option<(u16, u16)> {
        let [left, _] = self.x;
        let [_, top] = self.y;
        // Dots lie in the middle of themselves.
        let column = ((place.right - left) / self.dot + 0.5) / ACROSS;
        let row = ((top - place.ahead) / self.dot + 0.5) / DOWN;
        let inside = (0.0..f64::from(self.area.width)).contains(&column)
            && (0.0..f64::from(self.area.height)).contains(&row);
        inside.then(|| (self.area.x + column as u16, self.area.y + row as u16))
    }
}

/// The cells that have a label.
#[derive(Default)]
struct LabelSpace {
    taken: Vec<(u16, u16, u16)>,
}

impl LabelSpace {
    /// Takes so many cells and a blank on either side, if nobody has them.
    fn take(&mut self, row: u16, column: u16, width: u16) -> bool {
        let apart = |(other, from, until): &(u16, u16, u16)| {
            *other != row || column > *until || column + width < *from
        };
        let free = self.taken.iter().all(apart);
        if free {
            self.taken.push((row, column, column + width));
        }
        free
    }
}
