//! Help texts: the full help, and the line of keys at the bottom.

use std::borrow::Cow;
use std::fmt::Write;

use ratatui::text::{Line, Span};

use super::layer::Layer;
use super::model::Model;
use super::palette::Palette;
use super::symbols::mark;
use crate::plot::missing::MissingKind;

/// Key, its word in the bottom line (empty: in the help only), and its meaning.
type Key = (&'static str, &'static str, &'static str);

const PICTURE: &[Key] = &[("+ -", "zoom", "zoom in and out; 0 shows all")];
const PAUSE: &[Key] = &[("space", "pause", "pause; the sensor keeps measuring")];
const SELECTION: &[Key] = &[("Tab", "select", "select another sensor, as do 1 to 9")];
const WINDOW: &[Key] = &[
    ("w", "window", "next window: detection, ±90°, ±45°, full"),
    ("c", "", "steps per point: 1, 2, 4, 8"),
];
const RECORDING: &[Key] = &[
    ("space", "pause", "pause and play; at the end play again"),
    ("← →", "seek", "5 s back and on, with Shift a minute"),
    (", .", "step", "one scan back and on"),
    ("Home End", "", "the first and the last scan"),
    ("[ ]", "speed", "half and twice the speed; o loops, or not"),
];
const HELP: Key = ("?", "help", "");
const QUIT: Key = ("q", "quit", "quit, as does Ctrl-C");

/// Column where the meaning of a key begins.
const INDENT: usize = BLANKS.len();
/// Indent of a continuation line.
const BLANKS: &str = "         ";

pub(super) const TITLE: &str = " Keys: ↑ ↓ scroll, others close ";

/// Titles and keys of the help, grouped by what the keys act on.
fn sections(model: &Model) -> [(&'static str, Vec<&'static [Key]>); 2] {
    if model.playback.is_some() {
        [("The recording:", vec![RECORDING]), ("The picture:", vec![PICTURE, WINDOW])]
    } else if model.has_several() {
        [
            ("The picture, of all sensors:", vec![SELECTION, PICTURE, PAUSE]),
            ("The selected sensor:", vec![WINDOW]),
        ]
    } else {
        [("The picture:", vec![PICTURE, PAUSE]), ("The sensor:", vec![WINDOW])]
    }
}

/// Builds the help: the keys, the colours, and the marks at the rim.
pub(super) fn text(model: &Model) -> String {
    let line = |(key, _, meaning): &Key| format!("{key:<INDENT$}{meaning}\n");
    let mut text = String::new();
    for (title, keys) in sections(model) {
        text.extend([title.to_owned(), "\n".to_owned()]);
        text.extend(keys.into_iter().flatten().map(line));
    }
    text.push_str(&line(&QUIT));
    text.push_str(match (model.has_several(), model.layers.iter().any(Layer::has_intensities)) {
        (true, false) => {
            "Points have their sensor's colour;\n○ is the selected sensor's nearest.\n"
        }
        (true, true) => {
            "Points have their sensor's colour, darker\nwhere little light came back;\n\
             ○ is the selected sensor's nearest.\n"
        }
        (false, false) => "Points are coloured by distance; ○ is the nearest.\n",
        (false, true) => "Points are coloured by intensity; ○ is the nearest.\n",
    });
    text.push_str("At the rim, directions without a distance:");
    for kind in MissingKind::ALL {
        // Writing to a `String` is infallible.
        let _ = write!(text, "\n{} {:<5}  {}", mark(kind), kind.name(), kind.meaning());
    }
    text
}

/// Breaks lines longer than `width` between words. Continuations align with the key's meaning.
pub(super) fn folded(text: &str, width: usize) -> Vec<String> {
    let fold = |line: &str| {
        let has_key = line.chars().nth(INDENT - 1) == Some(' ');
        let indent = if has_key { BLANKS } else { "" };
        let options = textwrap::Options::new(width).subsequent_indent(indent);
        textwrap::wrap(line, options).into_iter().map(Cow::into_owned).collect::<Vec<_>>()
    };
    text.lines().flat_map(fold).collect()
}

/// Fits as many keys as possible into a line of `width` columns. Keeps the first and the last.
pub(super) fn key_line(width: u16, model: &Model) -> Line<'static> {
    let columns = |(key, word, _): &Key| key.chars().count() + word.len() + 5;
    let mut left = usize::from(width).saturating_sub(columns(&HELP) + columns(&QUIT));
    let keys = sections(model).into_iter().flat_map(|(_, keys)| keys).flatten();
    let keys = keys.filter(|key| {
        let rest = left.checked_sub(columns(key)).filter(|_| !key.1.is_empty());
        left = rest.unwrap_or(left);
        rest.is_some()
    });
    let mut line = Line::default();
    for (key, word, _) in [&HELP].into_iter().chain(keys).chain([&QUIT]) {
        line.push_span(Span::styled(format!(" {key} "), Palette::bar()));
        line.push_span(Span::styled(format!(" {word}  "), Palette::quiet()));
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
        let lines = super::folded(&super::text(&Model::new(Vec::new())), 36);
        assert!(lines.iter().all(|line| line.chars().count() <= 36), "{lines:?}");
    }
}
