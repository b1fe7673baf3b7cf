#!/usr/bin/env bash
# pymcap-cli 0.34.0 (PyPI) leaves the schema of a topic without messages out of its copies, but not always the channel.
#
# Here schemas and channels lie before the chunks, and each chunk repeats the channels, as the format permits. Expected
# of `compress` and `recover`, which exit with 0: a copy that others read, too. They write schema and channel of a topic
# before its first message only, but copy chunks as they are: with a channel whose schema is nowhere. So mcap 1.6.0
# (PyPI) cannot read the copy from a pipe, and pymcap-cli's own `doctor` refuses it.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import io
import os
import struct
import subprocess
import sys
import zlib

from place import PLACE, compare, pypi

tools = pypi("pymcap-cli==0.34.0", "mcap==1.6.0")
from mcap.exceptions import McapError  # noqa: E402
from mcap.reader import NonSeekingReader  # noqa: E402
from mcap_files import MAGIC, channel, data_end, message, record, schema, text, time_of  # noqa: E402

SILENT = struct.pack("<HH", 2, 2) + text("/silent") + text("cdr") + text(b"")
SILENT_SCHEMA = struct.pack("<H", 2) + text("std_msgs/msg/Bool") + text("ros2msg") + text("bool data\n")


def chunk(numbers, inner):
    """A chunk of the messages with these numbers, after other records, and the index of the messages."""
    entries = b""
    for number in numbers:
        entries += struct.pack("<QQ", time_of(number), len(inner))
        inner += message(number)
    head = struct.pack("<QQQI", time_of(numbers[0]), time_of(numbers[-1]), len(inner), zlib.crc32(inner))
    index = record(7, struct.pack("<H", 1) + text(entries))
    return record(6, head + text("") + struct.pack("<Q", len(inner)) + inner) + index


def recording(schemas, channels):
    chunks = chunk([0, 1], channels) + chunk([2, 3], channels)
    head = MAGIC + record(1, text("ros2") + text("findings"))
    return head + schemas + channels + chunks + data_end() + record(2, bytes(20)) + MAGIC


def pymcap(*words):
    command = [sys.executable, tools / "bin/pymcap-cli", "--quiet", *words]
    environment = dict(os.environ, PYTHONPATH=str(tools))
    return subprocess.run(command, capture_output=True, env=environment).returncode


def read(path):
    try:
        return len(list(NonSeekingReader(io.BytesIO(path.read_bytes())).iter_messages()))
    except McapError as error:
        return str(error)


files = {
    "one topic": recording(schema(), channel()),
    "and a silent one": recording(schema() + record(3, SILENT_SCHEMA), channel() + record(4, SILENT)),
}
seen = {}
for name, data in files.items():
    path = PLACE / "file.mcap"
    path.write_bytes(data)
    seen[name] = {"file": (read(path), pymcap("doctor", path))}
    for command in ("compress", "recover"):
        copy = PLACE / f"{command}.mcap"
        seen[name][command] = (pymcap(command, path, "-o", copy, "--force"), read(copy), pymcap("doctor", copy))
missing = "no schema record found with id 2"
compare(seen, {
    "one topic": {"file": (4, 0), "compress": (0, 4, 0), "recover": (0, 4, 0)},
    "and a silent one": {"file": (4, 0), "compress": (0, missing, 1), "recover": (0, missing, 1)},
})
END
