//! Symbols and labels of the picture and its legends.

use crate::plot::missing::MissingKind;

/// Symbol of the grid. Scans are Braille dots, which look different even without colours.
pub(super) const GRID: &str = "·";
/// Mark at the rim for a direction without a distance.
pub(super) fn mark(kind: MissingKind) -> &'static str {
    match kind {
        MissingKind::Far => "^",
        MissingKind::Weak => "~",
        MissingKind::Nothing => "x",
    }
}

/// Label of a sensor: the key that selects it. `number` counts from 0.
pub(super) fn sign(number: usize) -> String {
    (number + 1).to_string()
}
