#!/usr/bin/env bash
# kappe 0.25.0 (PyPI) cuts by the publish time: a latched map, recorded in the range, is in no part, without a word.
#
# Its README says that a split "is compared against the log time". A recorder logs a latched message when it subscribes,
# but rosbag2 since Jazzy also keeps when it was published, perhaps hours before. Expected of two adjacent splits, as the
# README has them: each message in one part. kappe reads by the log time and compares the publish time. A message on the
# border is in both parts, and one of a topic without a schema, as JSON may be, in neither. It exits with 0.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import os
import subprocess
import sys

from place import PLACE, compare, pypi

tools = pypi("kappe==0.25.0", "mcap==1.6.0")
from mcap.reader import make_reader  # noqa: E402
from mcap.writer import Writer  # noqa: E402

SECOND = 10**9


def read(path):
    """The topics in the order of the file, each with its second."""
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages(log_time_order=False)
        return [f"{channel.topic} {message.log_time // SECOND}" for _, channel, message in messages]


recording = PLACE / "recording.mcap"
with recording.open("wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2")
    text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    latched = writer.register_channel("/map", "cdr", text)
    usual = writer.register_channel("/chatter", "cdr", text)
    notes = writer.register_channel("/notes", "json", 0)
    data = b"\0\1\0\0\2\0\0\0a\0"
    writer.add_message(latched, 101 * SECOND, data, 1 * SECOND)
    for second in range(102, 105):
        writer.add_message(usual, second * SECOND, data, second * SECOND)
    writer.add_message(notes, 104 * SECOND, b"{}", 104 * SECOND)
    writer.finish()

splits = [{"start": 100, "end": 103, "name": "first"}, {"start": 103, "end": 106, "name": "second"}]
command = [sys.executable, tools / "bin/kappe", "--progress", "false", "cut", recording, "--output", PLACE / "parts"]
environment = dict(os.environ, PYTHONPATH=str(tools))
done = subprocess.run([*command, "--splits", json.dumps(splits)], capture_output=True, env=environment)
seen = {
    "recording": read(recording),
    "exit status": done.returncode,
    "first part": read(PLACE / "parts/first.mcap"),
    "second part": read(PLACE / "parts/second.mcap"),
}
expected = [
    ["/map 101", "/chatter 102", "/chatter 103", "/chatter 104", "/notes 104"],
    0,
    ["/chatter 102", "/chatter 103"],
    ["/chatter 103", "/chatter 104"],
]
compare(seen, dict(zip(seen, expected)))
END
