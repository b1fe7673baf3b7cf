//! [`Definitions`]: the schemas and channels of a file; and [`DefinitionWriter`], which gives them
//! numbers in another one.

use std::collections::{HashMap, HashSet};
use std::io::Write;

use super::form::map;
use super::{Fields, McapWriter, kind};

/// Largest number of bytes of the definitions of one file.
const MAX_DEFINITION_BYTES: usize = 64 << 20;

/// Schemas and channels of a file, up to a position in it.
#[derive(Default)]
pub(crate) struct Definitions {
    /// Content of each, after its number.
    contents: HashMap<(u8, u16), Vec<u8>>,
    bytes: usize,
}

impl Definitions {
    /// Remembers a well-formed schema or channel. Returns false if there is no room for it.
    pub(crate) fn define(&mut self, kind: u8, content: &[u8]) -> bool {
        let mut fields = Fields(content);
        let Some(number) = fields.u16() else { return false };
        let known = self.contents.entry((kind, number)).or_default();
        let bytes = self.bytes - known.len() + content.len();
        if bytes > MAX_DEFINITION_BYTES {
            return false;
        }
        self.bytes = bytes - (content.len() - fields.0.len());
        known.clear();
        known.extend_from_slice(fields.0);
        true
    }

    /// Returns what a channel's definition says.
    pub(crate) fn channel(&self, number: u16) -> Option<Channel<'_>> {
        let mut fields = Fields(self.get(kind::CHANNEL, number)?);
        let schema = self.get(kind::SCHEMA, fields.u16()?);
        let schema = schema.and_then(|content| Fields(content).string());
        let (topic, _encoding) = (fields.string()?, fields.string()?);
        Some(Channel { topic, schema, metadata: map(&mut fields)? })
    }

    fn get(&self, kind: u8, number: u16) -> Option<&[u8]> {
        self.contents.get(&(kind, number)).filter(|content| !content.is_empty()).map(Vec::as_slice)
    }
}

/// Definition of a channel.
#[derive(Debug)]
pub(crate) struct Channel<'a> {
    pub(crate) topic: &'a str,
    /// Name of its schema, if it has one.
    pub(crate) schema: Option<&'a str>,
    pub(crate) metadata: Vec<(&'a str, &'a str)>,
}

/// Writes schemas and channels with numbers of their own: equal ones have one number, and others
/// never do.
#[derive(Default)]
pub(crate) struct DefinitionWriter {
    numbers: HashMap<(u8, Vec<u8>), u16>,
    taken: HashSet<(u8, u16)>,
    bytes: usize,
}

impl DefinitionWriter {
    /// Returns the number of a channel, which it writes before its first use, and its schema with
    /// it. `lost_schema` may know the content of a schema that is not defined, from the channel's
    /// number and content. Returns `None` if the channel is not defined, or the file has no room for it.
    pub(crate) fn channel<W: Write>(
        &mut self,
        number: u16,
        of: &Definitions,
        lost_schema: impl FnOnce(u16, &[u8]) -> Option<Vec<u8>>,
        writer: &mut McapWriter<W>,
    ) -> Option<u16> {
        let content = of.get(kind::CHANNEL, number)?;
        let mut fields = Fields(content);
        let schema = fields.u16()?;
        let lost = lost_schema(number, content).filter(|_| schema != 0);
        let schema = match of.get(kind::SCHEMA, schema).or(lost.as_deref()) {
            Some(content) => self.number(kind::SCHEMA, schema, content, writer)?,
            // Stands for no schema.
            None => 0,
        };
        let content = [&schema.to_le_bytes(), fields.0].concat();
        self.number(kind::CHANNEL, number, &content, writer)
    }

    /// Writes the schemas and channels of a file that are not written yet. Returns false if the file
    /// has no room for one.
    pub(crate) fn rest<W: Write>(
        &mut self,
        of: &Definitions,
        lost_schema: impl Fn(u16, &[u8]) -> Option<Vec<u8>>,
        writer: &mut McapWriter<W>,
    ) -> bool {
        let contents = of.contents.iter().filter(|(_, content)| !content.is_empty());
        let mut wanted: Vec<_> = contents.map(|(number, _)| *number).collect();
        // Schemas come first.
        wanted.sort_unstable();
        let written = wanted.into_iter().map(|(kind, number)| match kind {
            kind::SCHEMA => self.number(kind, number, of.get(kind, number)?, writer),
            _ => self.channel(number, of, &lost_schema, writer),
        });
        written.fold(true, |all, number| all & number.is_some())
    }

    /// Returns the number of a definition: the wanted one if it is free.
    fn number<W: Write>(
        &mut self,
        kind: u8,
        wanted: u16,
        content: &[u8],
        writer: &mut McapWriter<W>,
    ) -> Option<u16> {
        let key = (kind, content.to_vec());
        if let Some(number) = self.numbers.get(&key) {
            return Some(*number);
        }
        let bytes = self.bytes + content.len();
        if bytes > MAX_DEFINITION_BYTES {
            return None;
        }
        // Mostly the wanted one, or one that is not used yet.
        let unused = u16::try_from(self.taken.len() + 1).unwrap_or(1);
        let mut numbers = [wanted, unused].into_iter().chain(1..=u16::MAX);
        let number = numbers.find(|number| !self.taken.contains(&(kind, *number)))?;
        self.bytes = bytes;
        self.taken.insert((kind, number));
        writer.declare(kind, number, content);
        self.numbers.insert(key, number);
        Some(number)
    }
}
