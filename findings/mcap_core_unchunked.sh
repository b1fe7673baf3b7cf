#!/usr/bin/env bash
# @mcap/core 2.2.2 (npm): McapIndexedReader opens a file without chunks and yields no message.
#
# The file is valid and has a summary, whose statistics say 4 messages. Expected: the messages, or the
# error "File is not indexed" that a file without a summary gets.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import subprocess

from mcap_files import chunked, unchunked
from place import compare, npm

READ = """
import { McapIndexedReader } from "@mcap/core";
import fs from "fs";
const bytes = new Uint8Array(fs.readFileSync(process.argv[2]));
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (at, length) => bytes.slice(Number(at), Number(at + length)),
};
const reader = await McapIndexedReader.Initialize({ readable });
const read = [];
for await (const message of reader.readMessages()) read.push(message.sequence);
console.log(JSON.stringify([Number(reader.statistics.messageCount), read]));
"""

folder = npm("@mcap/core@2.2.2")
(folder / "read.mjs").write_text(READ)


def read(data):
    (folder / "file.mcap").write_bytes(data)
    return json.loads(subprocess.check_output(["node", "read.mjs", "file.mcap"], cwd=folder))


seen = {"with chunks": read(chunked()), "without": read(unchunked())}
compare(seen, {"with chunks": [4, [0, 1, 2, 3]], "without": [4, []]})
END
