#!/usr/bin/env bash
# mcap 0.26.0 (crates.io) writes a wrong checksum of the data if chunks are to have none.
#
# Chunks, data, summary and attachments each have an option for their checksum. Expected of
# `calculate_chunk_crcs(false)` alone: 0 for the chunk, which means none, and the checksum of the data as before. But
# that one leaves out what is in chunks. mcap 1.6.0 (PyPI) reads the file, unless it validates checksums.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import struct
import subprocess
import zlib

from place import PLACE, cargo, compare, pypi

WRITE = """
use std::{collections::BTreeMap, fs::File};

fn main() -> mcap::McapResult<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let options = mcap::WriteOptions::new().compression(None);
    let options = options.calculate_chunk_crcs(arguments[2] == "true");
    let mut writer = options.create(File::create(&arguments[1])?)?;
    let channel_id = writer.add_channel(0, "/chatter", "json", &BTreeMap::new())?;
    let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, b"{}")?;
    writer.finish()?;
    Ok(())
}
"""

program = cargo(WRITE, 'mcap = { version = "=0.26.0", default-features = false }')
pypi("mcap==1.6.0")
from mcap.reader import NonSeekingReader  # noqa: E402


def data_end(data):
    """Where the record "data end" begins."""
    at = 8
    while data[at] != 15:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return at


def write(chunk_crcs):
    path = PLACE / "file.mcap"
    subprocess.run([program, path, chunk_crcs], check=True)
    data = path.read_bytes()
    at = data_end(data)
    is_right = struct.unpack_from("<I", data, at + 9)[0] == zlib.crc32(data[:at])
    try:
        with path.open("rb") as file:
            read = len(list(NonSeekingReader(file, validate_crcs=True).iter_messages()))
    except ValueError as error:
        read = str(error).partition(",")[0]
    return "right" if is_right else "wrong", read


seen = {"as usual": write("true"), "calculate_chunk_crcs(false)": write("false")}
compare(seen, {
    "as usual": ("right", 1),
    "calculate_chunk_crcs(false)": ("wrong", "crc validation failed in DataEnd"),
})
END
