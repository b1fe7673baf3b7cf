#!/usr/bin/env bash
# @mcap/core 2.2.2 (npm) cannot open a file whose "data end" record has grown.
#
# The format lets a record have new fields at its end, which readers skip. Expected: the messages, as
# with every other record that has grown. It reads the record as if its length were fixed, and takes
# bytes of it for the length of another record. The Python packages mcap and rosbags read the file.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import subprocess

from mcap_files import chunked
from place import compare, npm

READ = """
import { McapIndexedReader } from "@mcap/core";
import fs from "fs";
const bytes = new Uint8Array(fs.readFileSync(process.argv[2]));
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (at, length) => bytes.slice(Number(at), Number(at + length)),
};
try {
  await McapIndexedReader.Initialize({ readable });
  console.log("opened");
} catch (error) {
  console.log(error.message.replace(/ \\[.*/s, ""));
}
"""

folder = npm("@mcap/core@2.2.2")
(folder / "read.mjs").write_text(READ)


def read(data):
    (folder / "file.mcap").write_bytes(data)
    answer = subprocess.check_output(["node", "read.mjs", "file.mcap"], cwd=folder, text=True)
    return answer.strip()


grown = read(chunked(grown_end=b"\1\2\3\4\5\6"))
compare(
    {"as usual": read(chunked()), "grown by 6 bytes": grown},
    {"as usual": "opened", "grown by 6 bytes": "Record content length 144396663052566528 is too large"},
)
END
