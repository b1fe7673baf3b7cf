//! The texts about keys: the help, and the line at the bottom.

use std::fmt::Write;

use ratatui::text::{Line, Span};

use super::palette::Palette;
use super::radar::mark;
use crate::plot::missing::MissingKind;

/// The keys of the line at the bottom. On a narrow screen the first and the last
/// one stay.
const SENSOR_KEYS: [(&str, &str); 7] = [
    ("?", "help"),
    ("+ -", "zoom"),
    ("space", "pause"),
    ("w", "window"),
    ("l", "laser"),
    ("s", "save"),
    ("q", "quit"),
];
const PLAYBACK_KEYS: [(&str, &str); 7] = [
    ("?", "help"),
    ("space", "pause"),
    ("← →", "seek"),
    (", .", "step"),
    ("[ ]", "speed"),
    ("+ -", "zoom"),
    ("q", "quit"),
];

pub(super) const TITLE: &str = " Keys: ↑ ↓ scroll, others close ";

const ON_SENSORS: &str = "\
space    pause the picture; the sensor goes on
← →      turn the window by 15°
l        switch the laser off and on; it stays so
";

const ON_RECORDINGS: &str = "\
space    pause and play; at the end play again
← →      5 s back and on, with Shift a minute
, .      one scan back and on
[ ]      half and twice the speed
Home End the first and the last scan
o        begin again at the end, or not
";

const ON_BOTH: &str = "\
+ -      zoom in and out; 0 shows all
w        next window: detection, ±90°, ±45°, full
↑ ↓      widen and narrow it by 15° on each side
c        steps per point: 1, 2, 4, 8
t        show the last ten scans behind this one
s        save the picture as SVG, here
q        quit, as does Ctrl-C
";

/// Returns the help. The keys of a sensor and of a recording differ.
pub(super) fn text(is_playback: bool) -> String {
    let own = if is_playback { ON_RECORDINGS } else { ON_SENSORS };
    let mut text = format!(
        "{ON_BOTH}{own}\nPoints are coloured by distance. At the rim are\n\
         the directions without one:"
    );
    for kind in MissingKind::ALL {
        // Writing to a string does not fail.
        let _ = write!(text, "\n{} {:<5}  {}", mark(kind), kind.name(), kind.meaning());
    }
    text
}

/// Returns as many keys as fit into a line of `width` columns.
pub(super) fn key_line(width: u16, is_playback: bool) -> Line<'static> {
    let keys = if is_playback { PLAYBACK_KEYS } else { SENSOR_KEYS };
    let columns = |(key, what): &(&str, &str)| key.chars().count() + what.len() + 5;
    let [first, .., last] = &keys;
    let mut left = usize::from(width).saturating_sub(columns(first) + columns(last));
    let mut line = Line::default();
    for key in &keys {
        if key != first && key != last {
            match left.checked_sub(columns(key)) {
                Some(rest) => left = rest,
                None => continue,
            }
        }
        let (key, what) = key;
        line.push_span(Span::styled(format!(" {key} "), Palette::bar()));
        // The last key needs no gap after it.
        let gap = if (*key, *what) == *last { "" } else { "  " };
        line.push_span(Span::styled(format!(" {what}{gap}"), Palette::quiet()));
    }
    line
}
