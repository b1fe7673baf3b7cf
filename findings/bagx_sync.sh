#!/usr/bin/env bash
# bagx 0.6.0 (PyPI): `sync` compares when messages were recorded and not when they were measured, and only one way.
#
# It rates two sensors, up to "excellent for tightly-coupled fusion", or else advises to compensate for their stamps.
# Expected: it compares the stamps in the headers, as a SLAM does. Scans with the same stamp, of which one came 40 ms
# later, as over RS-232, are "40ms" apart, and scans that were measured 40 ms apart but came together are "excellent".
# It also seeks a partner for each message of the first topic: a scanner of 10 Hz whose scans all have one of 20 Hz
# is in sync with it, but not the one of 20 Hz with that of 10 Hz.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import re
import subprocess

from place import LASER_SCAN, LIMITS, PLACE, compare, pypi

packages = pypi("bagx==0.6.0", "rosbags==0.11.9", "mcap==1.6.0", "mcap-ros2-support==0.6.0")
from mcap_ros2.writer import Writer  # noqa: E402

START = 1_700_000_000_000_000_000
TENTH = 100_000_000
LATE = 40_000_000


def verdict(first, second, measured=0, recorded=0, rear_period=TENTH):
    """Rates the scans of 20 s, of which those in front are measured and recorded later by these times."""
    path = PLACE / "run.mcap"
    writer = Writer(str(path))
    schema = writer.register_msgdef("sensor_msgs/msg/LaserScan", LASER_SCAN)
    front = [("/front", number * TENTH + measured, number * TENTH + recorded) for number in range(200)]
    rear = [("/rear", time, time) for time in range(0, 200 * TENTH, rear_period)]
    for topic, stamp, log_time in sorted([*front, *rear], key=lambda scan: scan[2]):
        stamp = {"sec": (START + stamp) // 10**9, "nanosec": (START + stamp) % 10**9}
        scan = {"header": {"stamp": stamp, "frame_id": "laser"}, "ranges": [1.0, 2.0, 3.0], **LIMITS}
        writer.write_message(topic, schema, scan, log_time=START + log_time, publish_time=START + log_time)
    writer.finish()
    command = [packages / "bin/bagx", "sync", path, first, second]
    environment = {**os.environ, "PYTHONPATH": str(packages), "COLUMNS": "200"}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    return re.search(r"/\w+ ↔ /\w+: (.* — .*)", said)[1].strip()


seen = {
    "recorded 40 ms later": verdict("/front", "/rear", recorded=LATE),
    "measured 40 ms later": verdict("/front", "/rear", measured=LATE),
    "10 and 20 Hz": verdict("/front", "/rear", rear_period=TENTH // 2),
    "20 and 10 Hz": verdict("/rear", "/front", rear_period=TENTH // 2),
}
excellent = "0.0ms — excellent for tightly-coupled fusion"
compare(seen, {
    "recorded 40 ms later": "40ms — enable per-point deskew / timestamp compensation",
    "measured 40 ms later": excellent,
    "10 and 20 Hz": excellent,
    "20 and 10 Hz": "25ms — enable per-point deskew / timestamp compensation",
})
END
