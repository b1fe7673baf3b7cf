//! The texts about keys: the help, and the line at the bottom.

use ratatui::text::{Line, Span};

use super::palette::Palette;

/// The keys of the line at the bottom. On a narrow screen the first and the last
/// one stay.
const KEYS: [(&str, &str); 7] = [
    ("?", "help"),
    ("+ -", "zoom"),
    ("space", "pause"),
    ("w", "window"),
    ("l", "laser"),
    ("s", "save"),
    ("q", "quit"),
];

pub(super) const TITLE: &str = " Keys: ↑ ↓ scroll, others close ";

pub(super) const TEXT: &str = "\
+ -      zoom in and out; 0 shows all
space    pause the picture; the sensor goes on
w        next window: detection, ±90°, ±45°, full
← →      turn the window by 15°
↑ ↓      widen and narrow it by 15° on each side
c        steps per point: 1, 2, 4, 8
t        show the last ten scans behind this one
l        switch the laser off and on; it stays so
s        save the picture as SVG, here
q        quit, as does Ctrl-C

Points are coloured by distance. At the rim are
the directions without one:
^ far    possibly beyond the range
~ weak   too little light came back
x none   no distance for other reasons";

/// Returns as many keys as fit into a line of `width` columns.
pub(super) fn key_line(width: u16) -> Line<'static> {
    let columns = |(key, what): &(&str, &str)| key.chars().count() + what.len() + 5;
    let [first, .., last] = &KEYS;
    let mut left = usize::from(width).saturating_sub(columns(first) + columns(last));
    let mut line = Line::default();
    for key in &KEYS {
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
