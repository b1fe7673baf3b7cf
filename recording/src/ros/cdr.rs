//! CDR as ROS 2 uses it: plain CDR (XCDR1), little-endian, after its encapsulation header. Reads XCDR2, too,
//! whose layout is the same unless a number has eight bytes. Knows no messages.
//!
//! Written by hand, because a message needs only a dozen primitives. The crates for CDR bring serde, which
//! needs an owned struct for each message; this encodes a scan in place.

/// Plain CDR, little-endian, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Writes one message. Alignment counts from the end of the header.
#[derive(Debug)]
pub(super) struct CdrWriter<'a> {
    out: &'a mut Vec<u8>,
}

impl<'a> CdrWriter<'a> {
    /// Starts a message in `out`, and drops the previous content.
    pub(super) fn new(out: &'a mut Vec<u8>) -> Self {
        out.clear();
        out.extend_from_slice(&HEADER);
        Self { out }
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.out.push(value);
    }

    /// Writes a string: its length with the NUL, its bytes, the NUL.
    pub(super) fn string(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.out.extend_from_slice(text.as_bytes());
        self.out.push(0);
    }

    /// Writes the length of a sequence. Its elements follow.
    pub(super) fn length(&mut self, elements: usize) {
        self.number(u32::try_from(elements).unwrap_or(u32::MAX).to_le_bytes());
    }

    pub(super) fn bytes(&mut self, parts: &[&[u8]]) {
        self.length(parts.iter().map(|part| part.len()).sum());
        parts.iter().for_each(|part| self.out.extend_from_slice(part));
    }

    /// Writes a number's bytes, the least one first, after padding to a multiple of their count.
    pub(super) fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        let written = self.out.len() - HEADER.len();
        self.out.resize(HEADER.len() + written.next_multiple_of(N), 0);
        self.out.extend_from_slice(&bytes);
    }
}

/// Why a message cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CdrError {
    /// It ends before its fields do, or a field is malformed.
    Malformed,
    /// It is compressed by zstd, as `ros2 bag record --compression-mode message` does.
    Compressed,
    /// It has another encoding than plain CDR, by the first two bytes.
    Encoding([u8; 2]),
}

/// First bytes of what zstd compresses.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Reads one message, in either byte order and with any options. Each method returns `None` if the
/// message is too short or malformed.
#[derive(Debug)]
pub(super) struct CdrReader<'a> {
    message: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

impl<'a> CdrReader<'a> {
    /// Starts after the header of XCDR1 (`00 00`, `00 01`) or of XCDR2 (`00 06`, `00 07`).
    pub(super) fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        match message.first_chunk() {
            None => Err(CdrError::Malformed),
            Some(&ZSTD) => Err(CdrError::Compressed),
            Some([0, kind @ (0 | 1 | 6 | 7), _, _]) => {
                Ok(Self { message, at: HEADER.len(), is_big_endian: kind % 2 == 0 })
            }
            Some([first, second, _, _]) => Err(CdrError::Encoding([*first, *second])),
        }
    }

    pub(super) fn i32(&mut self) -> Option<i32> {
        self.number().map(i32::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.number().map(u32::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Option<f32> {
        self.number().map(f32::from_le_bytes)
    }

    pub(super) fn string(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.text()?).ok()
    }

    /// Reads a string in any character set, without its NUL. Some programs write an empty string without one.
    pub(super) fn text(&mut self) -> Option<&'a [u8]> {
        let bytes = self.bytes()?;
        Some(bytes.strip_suffix(&[0]).unwrap_or(bytes))
    }

    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.take(length)
    }

    /// Reads a sequence of numbers. Checks its length before it allocates.
    pub(super) fn f32s(&mut self) -> Option<Vec<f32>> {
        let length = usize::try_from(self.u32()?).ok()?;
        let (numbers, _) = self.take(length.checked_mul(4)?)?.as_chunks::<4>();
        Some(numbers.iter().map(|number| f32::from_le_bytes(self.little_endian(*number))).collect())
    }

    pub(super) fn skip_f64s(&mut self, count: usize) -> Option<()> {
        self.at = HEADER.len() + (self.at - HEADER.len()).next_multiple_of(8);
        self.take(count.checked_mul(8)?).map(drop)
    }

    fn number(&mut self) -> Option<[u8; 4]> {
        self.at = self.at.next_multiple_of(4);
        let number = self.take(4)?.try_into().ok()?;
        Some(self.little_endian(number))
    }

    fn little_endian(&self, mut number: [u8; 4]) -> [u8; 4] {
        if self.is_big_endian {
            number.reverse();
        }
        number
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(count)?;
        let taken = self.message.get(self.at..end)?;
        self.at = end;
        Some(taken)
    }
}
