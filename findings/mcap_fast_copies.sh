#!/usr/bin/env bash
# mcap-ros2-support-fast 0.8.0 (PyPI) cannot write a LaserScan that it has read.
#
# Its README has figures for "Read + Write". Expected: a copy, as a filter of recordings makes one, and as
# mcap-ros2-support 0.6.0 does. It reads an array of numbers as a `memoryview`. When it writes one, it takes that for
# raw bytes, and refuses them. With a list instead, it writes the same bytes.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from io import BytesIO

from place import compare, pypi

pypi("mcap-ros2-support-fast==0.8.0", "mcap-ros2-support==0.6.0", "mcap==1.6.0")
from mcap.reader import make_reader  # noqa: E402
from mcap_ros2.decoder import DecoderFactory as Decoder  # noqa: E402
from mcap_ros2.writer import Writer  # noqa: E402
from mcap_ros2_support_fast import ROS2EncoderFactory as FastEncoder  # noqa: E402
from mcap_ros2_support_fast.decoder import DecoderFactory as FastDecoder  # noqa: E402

FIELDS = ["angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"]
DEFINITION = "\n".join([
    "std_msgs/Header header", *(f"float32 {field}" for field in FIELDS), "float32[] ranges", "float32[] intensities",
    "=" * 80, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id",
    "=" * 80, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"])
SCAN = {field: 0.0 for field in FIELDS} | {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "laser"}, "ranges": [1.0, 2.0], "intensities": []}


def write(message):
    file = BytesIO()
    with Writer(file) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/LaserScan", DEFINITION)
        writer.write_message("/scan", schema, message)
    return file


def read(file, decoder):
    file.seek(0)
    return next(make_reader(file, decoder_factories=[decoder]).iter_decoded_messages())


def fast_copy(schema, scan):
    try:
        return bytes(FastEncoder().encoder_for(schema)(scan))
    except ValueError as error:
        return str(error)


_, _, original, scan = read(write(SCAN), Decoder())
_, _, copy, _ = read(write(scan), Decoder())
schema, _, _, fast = read(write(SCAN), FastDecoder())
seen = {"mcap-ros2-support copies the same bytes": copy.data == original.data}
seen["mcap-ros2-support-fast reads"] = f"{type(fast.ranges).__name__} of {fast.ranges.format}: {list(fast.ranges)}"
seen["it copies"] = fast_copy(schema, fast)
fast.ranges = list(fast.ranges)
seen["it copies the same bytes, with a list"] = fast_copy(schema, fast) == original.data
expected = [
    True,
    "memoryview of f: [1.0, 2.0]",
    "raw byte buffers are only supported for uint8, byte, and char arrays",
    True,
]
compare(seen, dict(zip(seen, expected)))
END
