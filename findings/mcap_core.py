"""Reads MCAP files with @mcap/core 2.2.2."""

import json
import subprocess

from place import npm

READ = """
import { McapIndexedReader } from "@mcap/core";
import fs from "fs";
const bytes = new Uint8Array(fs.readFileSync(process.argv[2]));
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (at, length) => bytes.slice(Number(at), Number(at + length)),
};
async function messages() {
  const reader = await McapIndexedReader.Initialize({ readable });
  const read = [];
  for await (const message of reader.readMessages()) read.push(message.sequence);
  return [Number(reader.statistics.messageCount), read];
}
const told = await messages().catch((error) => error.message.replace(/ \\[.*/s, ""));
console.log(JSON.stringify(told));
"""

folder = npm("@mcap/core@2.2.2")
(folder / "read.mjs").write_text(READ)


def read(data):
    """Returns how many messages the statistics count and the numbers of those read, or the error."""
    (folder / "file.mcap").write_bytes(data)
    return json.loads(subprocess.check_output(["node", "read.mjs", "file.mcap"], cwd=folder))
