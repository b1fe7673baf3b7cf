#!/usr/bin/env bash
# mcap 0.26.0 (crates.io), and so foxglove-sdk: a killed program leaves messages in the file that no reader reads.
#
# Without compression each message goes into the file at once. Expected after a kill: a reader yields all of them, as it
# does if the file has no chunks. The length of the last chunk, and of its records, is 2^64 - 1 until the chunk is
# complete. mcap 1.6.0 (PyPI), @mcap/core 2.2.2 (npm) and the crate's own reader fail there, before the first of them.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import subprocess

from place import PLACE, cargo, compare, npm, pypi

PROGRAM = """
use std::{collections::BTreeMap, fs::File};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if arguments[2] == "read" {
        let data = std::fs::read(&arguments[1]).unwrap();
        let options = enumset::enum_set!(mcap::read::Options::IgnoreEndMagic);
        let messages = mcap::MessageStream::new_with_options(&data, options).unwrap();
        let read: Vec<_> = messages.collect();
        let error = read.iter().find_map(|message| message.as_ref().err());
        println!("{} {:?}", read.iter().flatten().count(), error.map(|error| error.to_string()));
        return;
    }
    let options = mcap::WriteOptions::new().compression(None).use_chunks(arguments[2] == "chunks");
    let mut writer = options.create(File::create(&arguments[1]).unwrap()).unwrap();
    let channel_id = writer.add_channel(0, "/chatter", "json", &BTreeMap::new()).unwrap();
    for sequence in 0..100 {
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    // As a kill does, this writes nothing more.
    std::process::abort();
}
"""
READ = """
import { McapStreamReader } from "@mcap/core";
import fs from "fs";
const reader = new McapStreamReader();
reader.append(new Uint8Array(fs.readFileSync(process.argv[2])));
let messages = 0, error = null;
try {
  for (let record; (record = reader.nextRecord()); ) messages += record.type === "Message";
} catch (caught) {
  error = caught.message.replace(/ \\[.*/s, "");
}
console.log(JSON.stringify([messages, error]));
"""

program = cargo(PROGRAM, 'mcap = { version = "=0.26.0", default-features = false }', 'enumset = "1"')
folder = npm("@mcap/core@2.2.2")
(folder / "read.mjs").write_text(READ)
pypi("mcap==1.6.0")
from mcap.exceptions import McapError  # noqa: E402
from mcap.records import Message  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402


def by_python(path):
    count = 0
    try:
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                count += isinstance(record, Message)
    except McapError as error:
        return count, type(error).__name__
    return count, None


seen = {}
for form in ["chunks", "no chunks"]:
    path = PLACE / "killed.mcap"
    subprocess.run([program, path, form], stderr=subprocess.DEVNULL)
    # The publish time and the data of each message.
    found = path.read_bytes().count(b"\0\0\0\0\0\0\0\0{}")
    by_npm = json.loads(subprocess.check_output(["node", "read.mjs", path], cwd=folder))
    by_rust = subprocess.check_output([program, path, "read"], text=True).strip()
    # The messages in the file, and what is read of it.
    seen[form] = [found, by_python(path), by_npm, by_rust]
too_long = "Record content length 18446744073709551615 is too large"
compare(seen, {
    "chunks": [
        100,
        (0, "RecordLengthLimitExceeded"),
        [0, too_long],
        '0 Some("Chunk ended in the middle of a record")',
    ],
    "no chunks": [100, (100, "EndOfFile"), [100, None], "100 None"],
})
END
