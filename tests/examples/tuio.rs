//! [`Frame`]: a bundle of TUIO 1.1, decoded by hand after the texts of OSC 1.0 and TUIO 1.1.

use std::collections::BTreeMap;

#[derive(Debug, Clone, PartialEq)]
enum Argument {
    Text(String),
    Int(i32),
    Float(f32),
}

/// Takes a string and its padding to four bytes.
fn text(bytes: &mut &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap();
    let (padded, rest) = bytes.split_at(end / 4 * 4 + 4);
    assert!(padded[end..].iter().all(|&byte| byte == 0), "{padded:?}");
    *bytes = rest;
    String::from_utf8(padded[..end].to_vec()).unwrap()
}

fn word(bytes: &mut &[u8]) -> [u8; 4] {
    let (word, rest) = bytes.split_first_chunk().unwrap();
    *bytes = rest;
    *word
}

/// Returns the arguments of a message: a word, and what follows.
fn message(mut bytes: &[u8]) -> (String, Vec<Argument>) {
    assert_eq!(text(&mut bytes), "/tuio/2Dcur");
    let tags = text(&mut bytes);
    let kind = text(&mut bytes);
    let argument = |tag| match tag {
        's' => Argument::Text(text(&mut bytes)),
        'i' => Argument::Int(i32::from_be_bytes(word(&mut bytes))),
        'f' => Argument::Float(f32::from_be_bytes(word(&mut bytes))),
        _ => panic!("{tags}"),
    };
    let arguments = tags.strip_prefix(",s").unwrap().chars().map(argument).collect();
    assert!(bytes.is_empty(), "{bytes:?}");
    (kind, arguments)
}

/// Cursor as it was sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cursor {
    pub(super) place: (f64, f64),
    pub(super) velocity: (f64, f64),
    pub(super) acceleration: f64,
}

impl Cursor {
    pub(super) fn speed(&self) -> f64 {
        self.velocity.0.hypot(self.velocity.1)
    }
}

#[derive(Debug)]
pub(super) struct Frame {
    pub(super) number: i32,
    /// Those alive, by their ids.
    pub(super) cursors: BTreeMap<i32, Cursor>,
}

impl Frame {
    /// Checks that a bundle has a source, then who is alive, the state of each and its number.
    pub(super) fn decode(mut bytes: &[u8], source: &str) -> Self {
        assert_eq!(text(&mut bytes), "#bundle");
        let immediately = [[0, 0, 0, 0], [0, 0, 0, 1]];
        assert_eq!([word(&mut bytes), word(&mut bytes)], immediately);
        let mut messages = Vec::new();
        while !bytes.is_empty() {
            let length = u32::from_be_bytes(word(&mut bytes)) as usize;
            let (one, rest) = bytes.split_at(length);
            messages.push(message(one));
            bytes = rest;
        }
        let [first, second, sets @ .., last] = messages.as_slice() else { panic!("{messages:?}") };
        assert_eq!(*first, ("source".to_owned(), vec![Argument::Text(source.to_owned())]));
        let cursor = |(kind, arguments): &(String, Vec<Argument>)| {
            assert_eq!(kind, "set");
            let &[Argument::Int(id), ref numbers @ ..] = arguments.as_slice() else {
                panic!("{arguments:?}")
            };
            let number = |argument: &Argument| match argument {
                Argument::Float(number) => f64::from(*number),
                _ => panic!("{arguments:?}"),
            };
            let numbers: Vec<f64> = numbers.iter().map(number).collect();
            let [x, y, dx, dy, acceleration] = numbers.try_into().unwrap();
            (id, Cursor { place: (x, y), velocity: (dx, dy), acceleration })
        };
        let all: Vec<(i32, Cursor)> = sets.iter().map(cursor).collect();
        let alive = all.iter().map(|&(id, _)| Argument::Int(id)).collect();
        assert_eq!(*second, ("alive".to_owned(), alive));
        let cursors: BTreeMap<_, _> = all.iter().copied().collect();
        assert_eq!(cursors.len(), all.len(), "{all:?}");
        let (kind, arguments) = last;
        let &[Argument::Int(number)] = arguments.as_slice() else { panic!("{last:?}") };
        assert_eq!(kind, "fseq");
        Self { number, cursors }
    }
}
