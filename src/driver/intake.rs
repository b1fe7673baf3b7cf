//! [`Intake`]: what a session makes of the bytes that come. The reply of
//! success to a `G` is decoded as it is found; everything else is a frame, for the
//! session to judge.

use std::io;

use bytes::BytesMut;
use tokio_util::codec::{Decoder, Encoder};

use crate::Window;
use crate::codec::{Frame, ScipCodec};
use crate::protocol::{Command, Reply};

/// What came.
#[derive(Debug)]
pub(super) enum Item {
    /// The whole reply of success to the last command, a `G`; its values are in
    /// [`Intake::values`].
    Scan,
    Frame(Frame),
}

/// The codec of a session.
#[derive(Debug)]
pub(super) struct Intake {
    codec: ScipCodec,
    /// Whether to give frames only, and no [`Item::Scan`].
    frames_only: bool,
    /// What the last command asked for.
    expected: Option<Window>,
    /// Those of the last scan.
    values: Vec<u16>,
}

impl Intake {
    pub(super) fn new(frames_only: bool) -> Self {
        Self { codec: ScipCodec::default(), frames_only, expected: None, values: Vec::new() }
    }

    /// The values of the last scan.
    pub(super) fn values(&self) -> &[u16] {
        &self.values
    }

    /// Takes the values of a scan that came as a frame.
    pub(super) fn take_values(&mut self, scan: &Reply<'_>) {
        self.values.clear();
        scan.values_into(&mut self.values);
    }

    /// Forgets what it knows of the buffer, for when that was emptied.
    pub(super) fn reset(&mut self) {
        self.codec.reset();
    }
}

impl Decoder for Intake {
    type Item = Item;
    type Error = io::Error;

    fn decode(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Item>> {
        if let Some(window) = self.expected
            && self.codec.decode_scan(window, buffer, &mut self.values)
        {
            return Ok(Some(Item::Scan));
        }
        Ok(self.codec.decode(buffer)?.map(Item::Frame))
    }

    fn decode_eof(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Item>> {
        Ok(self.codec.decode_eof(buffer)?.map(Item::Frame))
    }
}

impl Encoder<&Command> for Intake {
    type Error = io::Error;

    fn encode(&mut self, command: &Command, buffer: &mut BytesMut) -> io::Result<()> {
        self.expected = match command {
            Command::Distances(window) if !self.frames_only => Some(*window),
            _ => None,
        };
        self.codec.encode(command, buffer)
    }
}
