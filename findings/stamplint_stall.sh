#!/usr/bin/env bash
# stamplint 0.2.0 (PyPI) says of one or two topics that stop together: "the other topics kept flowing".
#
# Three scanners are silent for the same 5 s, and it blames the recorder or the host, "rather than each sensor failing
# on its own". Expected of two scanners, as on many robots: the same, or no cause. It says of each of them that the
# others kept flowing, "so look at that source alone", and even of the only topic of a file. Both would send you to the
# cables of sensors that are well.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import re
import subprocess
import sys

from place import LASER_SCAN, LIMITS, PLACE, compare, pypi

packages = pypi("stamplint==0.2.0", "rosbags==0.11.9", "mcap==1.6.0", "mcap-ros2-support==0.6.0")
from mcap_ros2.writer import Writer  # noqa: E402

START = 1_700_000_000_000_000_000


def verdict(scanners):
    """What stamplint concludes from scans at 10 Hz for 12 s, without those of 5 s, by all scanners."""
    path = PLACE / f"{scanners}.mcap"
    writer = Writer(str(path))
    schema = writer.register_msgdef("sensor_msgs/msg/LaserScan", LASER_SCAN)
    for number in [*range(40), *range(90, 120)]:
        time = START + number * 100_000_000
        stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
        scan = {"header": {"stamp": stamp, "frame_id": "laser"}, "ranges": [1.0, 2.0, 3.0], **LIMITS}
        for scanner in range(scanners):
            writer.write_message(f"/scan{scanner}", schema, scan, log_time=time, publish_time=time, sequence=number)
    writer.finish()
    run = [sys.executable, "-m", "stamplint.cli", str(path)]
    environment = {**os.environ, "PYTHONPATH": str(packages)}
    said = subprocess.run(run, env=environment, capture_output=True, text=True, check=False).stdout
    lines = said.split("verdict:")[-1].strip().splitlines()
    causes = re.compile(r"the other topics kept flowing, so look at that source alone|the recorder or the host stalled")
    return [causes.search(line).group() for line in lines if causes.search(line)]


alone = "the other topics kept flowing, so look at that source alone"
compare({scanners: verdict(scanners) for scanners in [1, 2, 3]},
        {1: [alone], 2: [alone, alone], 3: ["the recorder or the host stalled"]})
END
