#!/usr/bin/env bash
# mcap_bag_parser 0.3.1 and rosbag-resurrector 0.8.7 (PyPI) make tables of LaserScans without their ranges.
#
# Expected of `parse_mcap_file`, and of `to_polars` and `resurrector export`, which use the same rows: a column of
# ranges, or an error. mcap_bag_parser leaves out an array of more than 100 numbers, rosbag-resurrector one of more than
# 20. All else is there, and neither says a word.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import io
import struct

from place import PLACE, compare, pypi

pypi("mcap_bag_parser==0.3.1", "rosbag-resurrector==0.8.7", "mcap==1.6.0")
from mcap.writer import CompressionType, Writer  # noqa: E402
from mcap_bag.rosx_mcap_adapter import parse_mcap_file  # noqa: E402
from resurrector import BagFrame  # noqa: E402

NUMBERS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
LASER_SCAN = "\n".join([
    "std_msgs/Header header", *[f"float32 {name}" for name in NUMBERS], "float32[] ranges", "float32[] intensities",
    80 * "=", "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id",
    80 * "=", "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec", ""])


def scan(points):
    head = struct.pack("<BBHiII6s2x7f", 0, 1, 0, 1, 0, 6, b"laser\0", *[0.1] * len(NUMBERS))
    return head + struct.pack(f"<I{points}fI", points, *[1.5] * points, 0)


def recording(points):
    path = PLACE / f"{points}.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", LASER_SCAN.encode())
        channel = writer.register_channel("/scan", "cdr", schema)
        for second in range(1, 4):
            writer.add_message(channel, second * 10**9, scan(points), second * 10**9)
        writer.finish()
    return str(path)


def columns(path):
    """Returns how many columns of ranges and how many others each has for these scans."""
    # They print what they do.
    with contextlib.redirect_stdout(io.StringIO()):
        tables = parse_mcap_file(path)["/scan"], BagFrame(path)["/scan"].to_polars()
    ranges = [sum(name.startswith("ranges") for name in table.columns) for table in tables]
    return [(count, len(table.columns) - count) for count, table in zip(ranges, tables)]


seen = {points: columns(recording(points)) for points in (20, 21, 100, 101, 682)}
compare(seen, {
    20: [(20, 11), (20, 11)],
    21: [(21, 11), (0, 11)],
    100: [(100, 11), (0, 11)],
    101: [(0, 11), (0, 11)],
    682: [(0, 11), (0, 11)],
})
END
