#!/usr/bin/env bash
# Bags of ROS 1 from 2010: rosbags 0.11.9 (PyPI) does not open them, pymcap-cli 0.34.0 (PyPI) silently loses messages.
#
# In some of them (scan_tools' demo.bag, of a URG-04LX) the records that index a chunk declare 20 bytes an entry, and
# hold 12. ROS goes by the number of entries, so nobody noticed. Expected: all messages, or an error that names the
# record. rosbags fails with an assertion without text. pymcap-cli converts the first chunk, reports success and exits
# with 0. Both read all of a copy that rosbag itself has made.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import re
import struct
import subprocess
import sys

from place import PLACE, compare, pypi

tools = pypi("rosbags==0.11.9", "pymcap-cli==0.34.0", "rosbag-standalone==1.17.4.1")
import rosbag  # noqa: E402
from rosbags.rosbag1 import Reader  # noqa: E402

SENT = 100


class Text:
    """A message std_msgs/String, as rosbag takes raw ones."""

    _type, _md5sum, _full_text = "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n"


def write(path):
    with rosbag.Bag(path, "w", chunk_threshold=1000) as bag:
        for number in range(SENT):
            raw = ("std_msgs/String", struct.pack("<I", 40) + bytes(40), Text._md5sum, Text)
            bag.write("/chatter", raw, rosbag.bag.genpy.Time(1 + number), raw=True)


def declare(old, entry):
    """Returns the bag with this size of an entry in the records that index its chunks."""
    data, at = bytearray(old), 13
    while at < len(old):
        header = at + 4
        at = header + struct.unpack_from("<I", old, at)[0]
        # Such a record is of the kind 4, and tells the number of its entries.
        entries = re.search(rb"count=(....)", old[header:at], re.DOTALL)
        size = struct.unpack_from("<I", old, at)[0]
        if b"op=\x04" in old[header:at]:
            struct.pack_into("<I", data, at, entry * struct.unpack("<I", entries[1])[0])
        at += 4 + size
    return bytes(data)


def by_rosbag(path):
    with rosbag.Bag(path) as bag:
        return len(list(bag.read_messages(raw=True)))


def by_rosbags(path):
    try:
        with Reader(path) as reader:
            return len(list(reader.messages()))
    except AssertionError as error:
        return repr(error)


def by_pymcap(path):
    command = [sys.executable, tools / "bin/pymcap-cli", "bag2mcap", path, "-o", path.with_suffix(".mcap"), "--force"]
    environment = {"PYTHONPATH": str(tools), "PATH": "/usr/bin:/bin", "COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    return done.returncode, int(re.search(r"(\d+) messages", done.stdout + done.stderr)[1])


write(PLACE / "new.bag")
(PLACE / "old.bag").write_bytes(declare((PLACE / "new.bag").read_bytes(), 20))
seen = {
    f"{name}, {reader.__name__}": reader(PLACE / f"{name}.bag")
    for name in ("new", "old") for reader in (by_rosbag, by_rosbags, by_pymcap)
}
compare(seen, {
    "new, by_rosbag": 100,
    "new, by_rosbags": 100,
    "new, by_pymcap": (0, 100),
    "old, by_rosbag": 100,
    "old, by_rosbags": "AssertionError()",
    "old, by_pymcap": (0, 10),
})
END
