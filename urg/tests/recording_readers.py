"""Reads a recording with readers that others wrote, and holds what they read
against what the driver delivered.

    cargo test -p urg-recording
    pip install mcap-ros2-support rosbags rerun-sdk
    python3 urg/tests/recording_readers.py target/tmp/recording.mcap

Without rerun-sdk, the check of Rerun is left out.

Likewise `repaired.mcap`, which was cut off and damaged, and the files of split
recordings in `split/`.

The test leaves `recording.mcap`, and beside it `recording.txt`: a line a scan,
its stamp in nanoseconds, its frame, its ranges. Or, with the program:

    urg record emulated run.mcap --count 50
    urg stream run.mcap --rate max --count 50 > run.ndjson
    python3 urg/tests/recording_readers.py run.mcap laser

What was streamed has the ranges and, to the microsecond, the stamps; the frame
is the one that is named.
"""

import importlib.util
import json
import math
import os
import struct
import subprocess
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

BEYOND_RANGE = {0, 6, 16, 4095}
# Part of a revolution from the first ray to its end: steps 44..=725.
TURNED = 1 - (128 + 44) / 1024
# Part of a revolution that is measured.
MEASURED = (725 - 44 + 1) / 1024
# Nanoseconds from the first ray to the reply, at 600 revolutions a minute.
FIRST_RAY = round(TURNED * 100_000_000)
# A file of the tests, or a run of the program, whose headers have the motor's time.
IS_RUN = len(sys.argv) > 2


def single(number):
    """The nearest number of single precision, infinity and NaN included."""
    return struct.unpack("<f", struct.pack("<f", float(number)))[0]


def truth(path, replies):
    """Stamp, frame and ranges of each scan that the driver delivered."""
    if IS_RUN:
        lines = path.with_suffix(".ndjson").read_text().splitlines()
        for line, (_, _, stamp) in zip(lines, replies):
            line = json.loads(line)
            assert abs(stamp - line["stamp"] * 1e9) < 2_000, "another stamp"
            ranges = [range_of(code) for code in line["values"]]
            assert [r if math.isfinite(r) else None for r in ranges] == [
                None if r is None else single(r) for r in line["ranges"]
            ]
            yield stamp - FIRST_RAY, sys.argv[2], ranges
        return
    for line in path.with_suffix(".txt").read_text().splitlines():
        stamp, frame, *ranges = line.split(" ")
        yield int(stamp), frame, [single(range) for range in ranges]


def scan(message):
    stamp = message.header.stamp
    ranges = [float(range) for range in message.ranges]
    return stamp.sec * 1_000_000_000 + stamp.nanosec, message.header.frame_id, ranges


def same(left, right):
    equal = lambda a, b: a == b or math.isnan(a) and math.isnan(b)
    ranges = zip(left[2], right[2], strict=True)
    # Angles are single precision, which is worth some nanoseconds.
    stamps = abs(left[0] - right[0]) < 2_000
    return stamps and left[1] == right[1] and all(equal(a, b) for a, b in ranges)


def check(name, scans, expected):
    assert len(scans) == len(expected), f"{name}: {len(scans)} scans of {len(expected)}"
    for number, (found, wanted) in enumerate(zip(scans, expected)):
        assert same(found, wanted), f"{name}: scan {number} is another"
    print(f"{name}: {len(scans)} scans, stamps, frame and ranges are the same")


def check_lateness(scans):
    """Checks the time in each header against the arrival of its scan.

    A sensor answers when the first revolution after a request ends. So the first ray was a
    part of a revolution before the arrival, and the lateness of the arrival earlier still. No
    request leaves before the reply before it has arrived, which limits the lateness. After a late
    scan the next one may begin later, where that one ends; the scan before the first may not be
    recorded. All in nanoseconds: arrival, first ray, revolution.
    """
    before, end = 0, None
    for arrived, first_ray, revolution in scans:
        lateness = arrived - first_ray - TURNED * revolution
        # Its stamp rests on another reading of the two clocks.
        is_postponed = end is None or abs(first_ray - end) < 100_000
        assert lateness < arrived - before, (lateness, arrived - before)
        assert lateness > -1_000 or is_postponed, (lateness, first_ray, end)
        before, end = arrived, first_ray + MEASURED * revolution


def read_with_mcap(path):
    scans, replies, times = [], [], []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        names = [metadata.name for metadata in reader.iter_metadata()]
        assert names == ["tokio_scip"], names
        for schema, channel, record, message in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            if channel.topic == "/scan":
                assert schema.name == "sensor_msgs/msg/LaserScan"
                scans.append(scan(message))
                times.append((record.publish_time, scans[-1][0], message.scan_time * 1e9))
            if channel.topic == "/scip/replies" and message.layout.dim[0].label.startswith("G"):
                label, data = message.layout.dim[0].label, bytes(message.data)
                replies.append((label, data, record.publish_time))
    check_lateness(times)
    return scans, replies


def read_with_rosbags(path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(path) as reader:
        scans = []
        for connection, _, data in reader.messages():
            # The definition in the file is the one that ROS 2 has.
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            for name, definition in types.items():
                assert list(definition[1]) == list(store.get_msgdef(name).fields), name
            if connection.topic == "/scan":
                scans.append(scan(store.deserialize_cdr(data, connection.msgtype)))
    return scans


def read_as_ros1(path):
    """The scans in ROS 1's format, as the command of the guide converts them."""
    bag = path.with_suffix(".bag")
    bag.unlink(missing_ok=True)
    convert = Path(sys.executable).with_name("rosbags-convert")
    subprocess.run([convert, "--src", path, "--dst", bag], check=True)
    store = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Reader(bag) as reader:
        topic = [connection for connection in reader.connections if connection.topic == "/scan"]
        # The sum of ROS 1's own definition: subscribers refuse any other.
        assert [connection.digest for connection in topic] == ["90c7ef2dc6895d81024acba2ac42f369"]
        scans = [
            scan(store.deserialize_ros1(data, connection.msgtype))
            for connection, _, data in reader.messages(topic)
        ]
    bag.unlink()
    return scans


def range_of(code):
    """A 12-bit code in metres, after the protocol text and REP 117."""
    if code in BEYOND_RANGE:
        return math.inf
    return math.nan if code < 20 else single(code / 1000)


def ranges_of(reply):
    """The ranges in a reply to `G`, read from the protocol text alone."""
    label, data, _ = reply
    echo, status, *lines = data.decode("ascii").split("\n")
    assert (echo, status, lines[-2:]) == (label, "0", ["", ""]), data[:20]
    text = "".join(lines)
    pairs = zip(text[::2], text[1::2])
    return [range_of((ord(high) - 0x30) << 6 | ord(low) - 0x30) for high, low in pairs]


def read_cut_off(path, cut):
    """How many scans are found in a file that was cut off, within its last chunk."""
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    channels, scans = {}, 0
    with cut.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if type(record).__name__ == "Channel":
                    channels[record.id] = record.topic
                scans += isinstance(record, Message) and channels[record.channel_id] == "/scan"
        except Exception as error:
            print(f"a file cut off: {scans} scans, then {type(error).__name__}")
    cut.unlink()
    return scans


def check_with_rerun(path):
    """Rerun decodes each message, and finds all topics in order on all its timelines."""
    if not importlib.util.find_spec("rerun_cli"):
        return
    command = [sys.executable, "-m", "rerun_cli", "mcap", "check", "--full", path]
    # Its settings, which `.ci/run` has written, are not those of the user.
    environment = dict(os.environ, HOME=sys.prefix)
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # Its status is 0 with problems, too.
    assert "PROBLEM" not in done.stdout, done.stdout
    assert any("ok" in line and "/scan" in line for line in done.stdout.splitlines()), done.stdout
    assert "ros2_timestamp" in done.stdout, done.stdout
    print("rerun: the scans are decoded and in order")


def main():
    path = Path(sys.argv[1])
    check_with_rerun(path)
    scans, replies = read_with_mcap(path)
    expected = list(truth(path, replies))
    assert expected, "no scans at all"
    if IS_RUN:
        # A replay has the time of the arrivals, which `check_lateness` has compared.
        expected = [(found[0], *wanted[1:]) for found, wanted in zip(scans, expected, strict=True)]
    check("mcap-ros2-support", scans, expected)
    check("rosbags", read_with_rosbags(path), expected)
    check("ROS 1", read_as_ros1(path), expected)
    # Polls ask for some groups more than the stream wants.
    from_replies = [
        (stamp if IS_RUN else reply[2] - FIRST_RAY, frame, ranges_of(reply)[-len(ranges) :])
        for reply, (stamp, frame, ranges) in zip(replies, expected)
    ]
    check("the raw replies", from_replies, expected)
    # A short file has but one chunk, of which nothing is left.
    if len(expected) > 300:
        assert 0 < read_cut_off(path, path.with_suffix(".cut.mcap")) < len(expected)


main()
