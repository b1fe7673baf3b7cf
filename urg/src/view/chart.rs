//! [`Chart`]: maps metres to the dots and cells of a screen area, and keeps labels apart.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use ratatui::text::Span;
use ratatui::widgets::canvas::{Context, Points};

use crate::plot::{Anchor, Extent, Place};

/// Number of dots across and down a Braille cell.
const ACROSS: f64 = 2.0;
const DOWN: f64 = 4.0;

/// Scale and place of a picture in its area.
pub(super) struct Chart {
    area: Rect,
    /// Metres between two dots.
    pub(super) dot: f64,
    pub(super) x: [f64; 2],
    pub(super) y: [f64; 2],
}

impl Chart {
    /// Fits `extent`, in metres, into `area`, and leaves `margin` columns and rows free.
    pub(super) fn new(area: Rect, extent: Extent, margin: (f64, f64)) -> Self {
        let (columns, rows) = (f64::from(area.width), f64::from(area.height));
        let across = (columns - 2.0 * margin.0).max(1.0) * ACROSS;
        let down = (rows - 2.0 * margin.1).max(1.0) * DOWN;
        let dot =
            ((extent.left + extent.right) / across).max((extent.ahead + extent.behind) / down);
        let middle = |low: f64, high: f64, dots: f64| {
            let (middle, half) = ((high + low) / 2.0, (dots - 1.0) * dot / 2.0);
            [middle - half, middle + half]
        };
        Self {
            area,
            dot,
            x: middle(-extent.left, extent.right, columns * ACROSS),
            y: middle(-extent.behind, extent.ahead, rows * DOWN),
        }
    }

    /// Draws a dot at a place.
    pub(super) fn dot(&self, context: &mut Context<'_>, place: Place, color: Color) {
        context.draw(&Points { coords: &[(place.right, place.ahead)], color });
    }

    /// Writes `symbol` into the cell of each place, if the cell is empty.
    pub(super) fn cells(
        &self,
        buffer: &mut Buffer,
        places: impl Iterator<Item = Place>,
        symbol: &str,
        color: Color,
    ) {
        for position in places.filter_map(|place| self.cell(place)) {
            if let Some(cell) = buffer.cell_mut(position).filter(|cell| cell.symbol() == " ") {
                cell.set_symbol(symbol).set_fg(color);
            }
        }
    }

    /// Writes `text` if it fits completely and covers no other label. Returns whether it did.
    pub(super) fn label(
        &self,
        buffer: &mut Buffer,
        free: &mut LabelSpace,
        place: Place,
        anchor: Anchor,
        text: &str,
        style: Style,
    ) -> bool {
        let Some((column, row)) = self.cell(place) else { return false };
        let width = Span::raw(text).width() as u16;
        let column = match anchor {
            Anchor::Start => Some(column),
            Anchor::Middle => column.checked_sub(width / 2),
            Anchor::End => (column + 1).checked_sub(width),
        };
        let Some(column) = column
            .filter(|column| *column >= self.area.left() && column + width <= self.area.right())
        else {
            return false;
        };
        let fits = free.take(row, column, width);
        if fits {
            buffer.set_string(column, row, text, style);
        }
        fits
    }

    /// Finds the cell of a place; `None` outside the area.
    pub(super) fn cell(&self, place: Place) -> Option<(u16, u16)> {
        let [left, _] = self.x;
        let [_, top] = self.y;
        // A coordinate is the centre of its dot, hence the half dot.
        let column = ((place.right - left) / self.dot + 0.5) / ACROSS;
        let row = ((top - place.ahead) / self.dot + 0.5) / DOWN;
        let inside = (0.0..f64::from(self.area.width)).contains(&column)
            && (0.0..f64::from(self.area.height)).contains(&row);
        inside.then(|| (self.area.x + column as u16, self.area.y + row as u16))
    }

    /// Moves a place `columns` cells to the right and `rows` cells down.
    pub(super) fn beside(&self, place: Place, columns: f64, rows: f64) -> Place {
        Place {
            right: place.right + columns * ACROSS * self.dot,
            ahead: place.ahead - rows * DOWN * self.dot,
        }
    }
}

/// Cells that already have a label.
#[derive(Default)]
pub(super) struct LabelSpace {
    taken: Vec<(u16, u16, u16)>,
}

impl LabelSpace {
    /// Takes `width` cells and a blank on either side, if all of them are free.
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
