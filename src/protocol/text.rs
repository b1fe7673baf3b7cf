//! Bytes from a sensor, safe to show to a person.

use std::fmt;

/// Bytes that a sensor sent, unchanged.
///
/// [`Display`](fmt::Display) shows printable ASCII as it is and escapes everything else
/// (`\x1b`). So you can print it: no sensor can control your terminal or forge a line of
/// your log. `to_string()` makes a `String` with the same content.
///
/// As data (feature `serde`) it is the escaped form, too, which loses no byte.
///
/// ```
/// use tokio_scip::protocol::Text;
///
/// assert_eq!(Text::from(&b"URG\x1b[2J\xff"[..]).to_string(), r"URG\x1b[2J\xff");
/// ```
#[derive(Clone, PartialEq, Eq, Hash, Default, PartialOrd, Ord)]
pub struct Text(Box<[u8]>);

impl Text {
    /// Bytes as received.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Converts to text, or returns `None` if the bytes are not UTF-8. The text may hold
    /// control characters: write it to a terminal or a log with `Display` only.
    pub fn as_str(&self) -> Option<&str> {
        std::str::from_utf8(&self.0).ok()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns true if all bytes are printable ASCII.
    pub(crate) fn is_printable(&self) -> bool {
        self.0.iter().all(|byte| matches!(byte, b' '..=b'~'))
    }

    /// Copies the first 32 bytes at most, so that a message stays short.
    pub(super) fn excerpt(bytes: &[u8]) -> Self {
        Self::from(bytes.get(..32).unwrap_or(bytes))
    }
}

impl AsRef<[u8]> for Text {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl<T: AsRef<[u8]> + ?Sized> From<&T> for Text {
    fn from(bytes: &T) -> Self {
        Self(bytes.as_ref().into())
    }
}

impl From<String> for Text {
    fn from(text: String) -> Self {
        Self::from(&text)
    }
}

impl PartialEq<str> for Text {
    fn eq(&self, other: &str) -> bool {
        self.as_bytes() == other.as_bytes()
    }
}

impl PartialEq<&str> for Text {
    fn eq(&self, other: &&str) -> bool {
        self == *other
    }
}

impl PartialEq<String> for Text {
    fn eq(&self, other: &String) -> bool {
        self == other.as_str()
    }
}

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for &byte in &self.0 {
            match byte {
                b'\\' => f.write_str(r"\\")?,
                b'\n' => f.write_str(r"\n")?,
                b'\r' => f.write_str(r"\r")?,
                b' '..=b'~' => write!(f, "{}", char::from(byte))?,
                _ => write!(f, r"\x{byte:02x}")?,
            }
        }
        Ok(())
    }
}

impl fmt::Debug for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

#[cfg(feature = "serde")]
impl serde::Serialize for Text {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
