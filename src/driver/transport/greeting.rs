//! [`Greeting`]: the first bytes that a port delivers. A serial server writes its own words there,
//! such as "Port already in use", and closes the connection.

use crate::protocol::Text;

/// Longest greeting: telnet's options and a line of text.
const CAPACITY: usize = 160;
/// Telnet's escape byte, and the commands after it that matter here (RFC 854).
const IAC: u8 = 0xff;
const SE: u8 = 0xf0;
const SB: u8 = 0xfa;
const WILL: u8 = 0xfb;
const DONT: u8 = 0xfe;

/// First bytes received on a port, one more than the longest greeting has.
#[derive(Debug, Default)]
pub(crate) struct Greeting(Vec<u8>);

impl Greeting {
    /// Adds received bytes while there is room.
    pub(super) fn add(&mut self, fresh: &[u8]) {
        if self.0.len() <= CAPACITY {
            self.append(fresh);
        }
    }

    #[cold]
    fn append(&mut self, fresh: &[u8]) {
        let room = (CAPACITY + 1).saturating_sub(self.0.len());
        self.0.extend(fresh.iter().take(room));
    }

    /// Returns true if a telnet command came first, as from a server that negotiates options.
    pub(crate) fn is_telnet(&self) -> bool {
        matches!(self.0[..], [IAC, WILL..=DONT, ..])
    }

    /// Returns the text in the greeting, without telnet commands and with its lines joined by blanks.
    /// If it is longer, or something in it is not printable: its first line that ends in CR LF.
    /// `None` if there is no text, or the bytes can be part of a scan.
    pub(super) fn words(&self) -> Option<Text> {
        let text = without_telnet(&self.0);
        let is_printable = |byte: &u8| matches!(byte, b' '..=b'~');
        // No sensor sends a CR.
        let lines = text.split_inclusive(|byte| *byte == b'\n');
        let mut lines = lines.filter_map(|line| line.strip_suffix(b"\r\n"));
        let line = lines.find(|line| !line.is_empty() && line.iter().all(is_printable));
        let is_text = text.iter().all(|byte| is_printable(byte) || byte.is_ascii_whitespace());
        if self.0.len() > CAPACITY || !is_text {
            return line.map(Text::from);
        }
        // The characters of a scan end at `o`.
        let is_scan = line.is_none() && !text.iter().any(|byte| matches!(byte, b'p'..=b'z'));
        let words = text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        (!is_scan).then(|| words.collect::<Vec<_>>().join(&b' ').as_slice().into())
    }
}

/// Removes telnet commands: two bytes, three with an option, or up to the end of a subnegotiation.
fn without_telnet(mut bytes: &[u8]) -> Vec<u8> {
    let mut text = Vec::new();
    loop {
        bytes = match bytes {
            [] | [IAC] => return text,
            [IAC, SB, rest @ ..] => {
                let end = rest.windows(2).position(|pair| pair == [IAC, SE]);
                end.and_then(|end| rest.get(end + 2..)).unwrap_or_default()
            }
            [IAC, WILL..=DONT, _, rest @ ..] => rest,
            [IAC, _, rest @ ..] => rest,
            [byte, rest @ ..] => {
                text.push(*byte);
                rest
            }
        };
    }
}
