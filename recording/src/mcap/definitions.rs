//! [`Definitions`]: the schemas and channels of a file, which it writes into another one.

use std::collections::{BTreeMap, HashMap};
use std::io::Write;

use super::form::map;
use super::{Fields, MAX_DEFINITION_BYTES, McapWriter, kind};

/// Returns the content of a channel's schema that is not defined, from the channel's, if it is known.
pub(crate) type LostSchema = fn(&[u8]) -> Option<Vec<u8>>;

/// Schemas and channels of a file, up to a position in it.
#[derive(Default)]
pub(crate) struct Definitions {
    /// Content of each, after its number.
    contents: BTreeMap<(u8, u16), Vec<u8>>,
    /// Later definitions that may come from a damaged summary, until a message follows.
    doubted: Option<BTreeMap<(u8, u16), Vec<u8>>>,
    bytes: usize,
    /// Numbers of the channels in another file, by these definitions.
    written: HashMap<u16, u16>,
}

impl Definitions {
    /// Remembers a well-formed schema or channel. Returns false if there is no room for it.
    pub(super) fn define(&mut self, kind: u8, content: &[u8]) -> bool {
        let mut fields = Fields(content);
        let Some(number) = fields.u16() else { return false };
        let contents = self.doubted.as_mut().unwrap_or(&mut self.contents);
        let known = contents.get(&(kind, number)).map_or(0, Vec::len);
        let bytes = self.bytes - known + fields.0.len();
        if bytes > MAX_DEFINITION_BYTES {
            return false;
        }
        self.bytes = bytes;
        self.written.clear();
        contents.insert((kind, number), fields.0.to_vec());
        true
    }

    /// Remembers later definitions only if a message follows them.
    pub(super) fn doubt_later(&mut self) {
        self.doubted.get_or_insert_default();
    }

    pub(crate) fn channel(&self, number: u16) -> Option<Channel<'_>> {
        let mut fields = Fields(self.get(kind::CHANNEL, number)?);
        let schema = self.get(kind::SCHEMA, fields.u16()?).and_then(|it| Fields(it).string());
        let (topic, encoding) = (fields.string()?, fields.string()?);
        Some(Channel { topic, schema, encoding, metadata: fields })
    }

    /// Accepts a message, and so all definitions before it. Returns false if its channel is not defined.
    pub(super) fn accept(&mut self, channel: u16) -> bool {
        let channel = (kind::CHANNEL, channel);
        let is_defined = |later: &mut BTreeMap<_, _>| {
            later.contains_key(&channel) || self.contents.contains_key(&channel)
        };
        for (key, content) in self.doubted.take_if(is_defined).into_iter().flatten() {
            self.bytes -= self.contents.insert(key, content).map_or(0, |known| known.len());
        }
        self.contents.contains_key(&channel)
    }

    /// Writes a channel, after its schema, unless it is written. Returns its number there, or `None`
    /// if it is not defined, or the other file has no room for it.
    pub(crate) fn write_channel<W: Write>(
        &mut self,
        number: u16,
        lost_schema: LostSchema,
        writer: &mut McapWriter<W>,
    ) -> Option<u16> {
        if let Some(written) = self.written.get(&number) {
            return Some(*written);
        }
        let content = self.get(kind::CHANNEL, number)?;
        let mut fields = Fields(content);
        let schema = fields.u16()?;
        let lost = lost_schema(content);
        let schema = match self.get(kind::SCHEMA, schema).or(lost.as_deref()) {
            Some(content) => writer.declare(kind::SCHEMA, schema, content)?,
            // Stands for no schema.
            None => 0,
        };
        let content = [&schema.to_le_bytes(), fields.0].concat();
        let written = writer.declare(kind::CHANNEL, number, &content)?;
        self.written.insert(number, written);
        Some(written)
    }

    /// Writes what is not written yet. Returns false if the other file has no room for it.
    pub(crate) fn write_rest<W: Write>(
        &mut self,
        lost_schema: LostSchema,
        writer: &mut McapWriter<W>,
    ) -> bool {
        let numbers: Vec<_> = self.contents.keys().copied().collect();
        let written = numbers.into_iter().map(|(kind, number)| match kind {
            kind::SCHEMA => writer.declare(kind, number, self.get(kind, number)?),
            _ => self.write_channel(number, lost_schema, writer),
        });
        written.fold(true, |all, number| all & number.is_some())
    }

    fn get(&self, kind: u8, number: u16) -> Option<&[u8]> {
        self.contents.get(&(kind, number)).map(Vec::as_slice)
    }
}

#[derive(Debug)]
pub(crate) struct Channel<'a> {
    pub(crate) topic: &'a str,
    /// Name of its schema, if it has one.
    pub(crate) schema: Option<&'a str>,
    pub(crate) encoding: &'a str,
    metadata: Fields<'a>,
}

impl<'a> Channel<'a> {
    pub(crate) fn metadata(&self, key: &str) -> Option<&'a str> {
        map(&mut self.metadata.clone())?.remove(key)
    }
}
