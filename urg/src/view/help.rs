//! Help texts: the full help, and the line of keys at the bottom.

use std::borrow::Cow;
use std::fmt::Write;

use ratatui::text::{Line, Span};

use super::model::Model;
use super::palette::Palette;
use super::symbols::mark;
use crate::plot::missing::MissingKind;

/// Keys in the bottom line. A narrow screen keeps the first and the last.
const SENSOR_KEYS: [(&str, &str); 7] = [
    ("?", "help"),
    ("+ -", "zoom"),
    ("space", "pause"),
    ("w", "window"),
    ("l", "laser"),
    ("s", "save"),
    ("q", "quit"),
];
const SEVERAL_KEYS: [(&str, &str); 7] = [
    ("?", "help"),
    ("Tab", "select"),
    ("+ -", "zoom"),
    ("space", "pause"),
    ("w", "window"),
    ("l", "laser"),
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

/// Column where the meaning of a key begins.
const INDENT: usize = BLANKS.len();
/// Indent of a continuation line.
const BLANKS: &str = "         ";

pub(super) const TITLE: &str = " Keys: ↑ ↓ scroll, others close ";

const PICTURE: &str = "\
+ -      zoom in and out; 0 shows all
t        show the last ten scans behind this one
";

const QUIT: &str = "\
q        quit, as does Ctrl-C
";

const PAUSE: &str = "\
space    pause; the sensor keeps measuring
";

const SENSOR: &str = "\
← →      turn the window by 15°
l        switch the laser off and on; it stays so
";

const SELECTION: &str = "\
Tab 1-9  select another sensor
";

const RECORDING: &str = "\
space    pause and play; at the end play again
← →      5 s back and on, with Shift a minute
, .      one scan back and on
Home End the first and the last scan
[ ]      half and twice the speed; o loops, or not
";

const WINDOW: &str = "\
w        next window: detection, ±90°, ±45°, full
↑ ↓      widen and narrow it by 15° on each side
c        steps per point: 1, 2, 4, 8
s        save the scan as SVG, here
";

const COLOURS: &str = "\
Points are coloured by distance; ○ is the nearest.
";

const OWN_COLOURS: &str = "\
Points have their sensor's colour, or its number;
○ is the selected sensor's nearest.
";

/// Subject of the picture, which decides what the keys do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Subject {
    Sensor,
    Several,
    Recording,
}

impl Subject {
    pub(super) fn from_model(model: &Model) -> Self {
        match model.playback {
            Some(_) => Self::Recording,
            None if model.has_several() => Self::Several,
            None => Self::Sensor,
        }
    }
}

/// Builds the help: the keys, grouped by what they act on, and the marks at the rim.
pub(super) fn text(subject: Subject) -> String {
    let mut text = match subject {
        Subject::Sensor => {
            format!("The picture:\n{PICTURE}{PAUSE}{QUIT}The sensor:\n{WINDOW}{SENSOR}{COLOURS}")
        }
        Subject::Several => format!(
            "The picture, of all sensors:\n{PICTURE}{PAUSE}{QUIT}\
             The selected sensor:\n{SELECTION}{WINDOW}{SENSOR}{OWN_COLOURS}"
        ),
        Subject::Recording => {
            format!("The picture:\n{PICTURE}{WINDOW}{QUIT}The recording:\n{RECORDING}{COLOURS}")
        }
    };
    text.push_str("At the rim, directions without a distance:");
    for kind in MissingKind::ALL {
        // Writing to a `String` is infallible.
        let _ = write!(text, "\n{} {:<5}  {}", mark(kind), kind.name(), kind.meaning());
    }
    text
}

/// Breaks lines longer than `width` between words. Continuation lines align with the
/// meaning of their key.
pub(super) fn folded(text: &str, width: usize) -> Vec<String> {
    let fold = |line: &str| {
        let has_key = line.chars().nth(INDENT - 1) == Some(' ');
        let indent = if has_key { BLANKS } else { "" };
        let options = textwrap::Options::new(width).subsequent_indent(indent);
        textwrap::wrap(line, options).into_iter().map(Cow::into_owned).collect::<Vec<_>>()
    };
    text.lines().flat_map(fold).collect()
}

/// Fits as many keys as possible into a line of `width` columns.
pub(super) fn key_line(width: u16, subject: Subject) -> Line<'static> {
    let keys = match subject {
        Subject::Sensor => SENSOR_KEYS,
        Subject::Several => SEVERAL_KEYS,
        Subject::Recording => PLAYBACK_KEYS,
    };
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
        let gap = if (*key, *what) == *last { "" } else { "  " };
        line.push_span(Span::styled(format!(" {what}{gap}"), Palette::quiet()));
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_is_folded_under_its_meaning() {
        let text = "+ -      zoom in and out; 0 shows all\nPoints are coloured by distance.";
        let folded = folded(text, 24);
        let expected = [
            "+ -      zoom in and",
            "         out; 0 shows",
            "         all",
            "Points are coloured by",
            "distance.",
        ];
        assert_eq!(folded, expected);
        for subject in [Subject::Sensor, Subject::Several, Subject::Recording] {
            let text = self::text(subject);
            let lines = super::folded(&text, 36);
            assert!(lines.iter().all(|line| line.chars().count() <= 36), "{lines:?}");
        }
    }
}
