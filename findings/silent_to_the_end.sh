#!/usr/bin/env bash
# Five checkers of recordings (PyPI) find a scanner that is silent for 2 s, and none that is silent until the end.
#
# Expected of baglint 0.2.1, robot-triage 0.1.0, rosbag-doctor 0.1.1, bagx 0.6.0 (`anomaly`) and backplane-tracecheck
# 0.3.0: the unplugged scanner is worse, and reported too, since another scanner shows how long the recording is. But
# each judges only the pauses between two scans, and the rate between the first scan and the last one. rosbag-doctor
# even prints a coverage of 40 % above "No problems found". The contract of tracecheck (without times that you expect),
# and the specification that baglint makes of a good recording, demand a rate. clockdoctor 0.1.0 reports the scanner
# that ends early.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import os
import subprocess

from place import LASER_SCAN, LIMITS, PLACE, compare, pypi

packages = pypi("baglint==0.2.1", "robot-triage==0.1.0", "rosbag-doctor==0.1.1", "bagx==0.6.0",
                "backplane-tracecheck==0.3.0", "clockdoctor==0.1.0", "rosbags==0.11.9", "mcap==1.6.0",
                "mcap-ros2-support==0.6.0")
from mcap_ros2.writer import Writer  # noqa: E402

START = 1_700_000_000_000_000_000


def recording(name, front):
    """Twenty seconds of two scanners at 10 Hz, with these scans of the front one."""
    path = PLACE / f"{name}.mcap"
    writer = Writer(str(path))
    schema = writer.register_msgdef("sensor_msgs/msg/LaserScan", LASER_SCAN)
    for number in range(200):
        time = START + number * 100_000_000
        stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
        scan = {"header": {"stamp": stamp, "frame_id": "laser"}, "ranges": [1.0, 2.0 + number % 7, 3.0], **LIMITS}
        for topic in ["/rear/scan", *["/front/scan"] * (number in front)]:
            writer.write_message(topic, schema, scan, log_time=time, publish_time=time, sequence=number)
    writer.finish()
    return path


def run(program, *words):
    environment = {**os.environ, "PYTHONPATH": str(packages), "COLUMNS": "200"}
    command = [packages / "bin" / program, *words]
    return subprocess.run(command, cwd=PLACE, env=environment, capture_output=True, text=True, check=False).stdout


whole = recording("whole", range(200))
(PLACE / "specification.yaml").write_text(run("baglint", whole, "--init"))
demanded = {"required": True, "min_rate_hz": 9, "max_gap_ns": 300_000_000, "clock_confirmed": True,
            "time_basis": "log_time"}
contract = {"version": 1, "name": "scanners", "topics": {"/front/scan": demanded, "/rear/scan": demanded}}
(PLACE / "contract.json").write_text(json.dumps(contract))


def is_found(path):
    """Whether each checker finds something."""
    return {
        "baglint": "no findings" not in run("baglint", path, "--spec", "specification.yaml"),
        "robot-triage": "No issues detected" not in run("triage", "run", path),
        "rosbag-doctor": "No problems found" not in run("rosbag-doctor", path),
        "bagx": "Data looks clean" not in run("bagx", "anomaly", path),
        "backplane-tracecheck": not run("tracecheck", "check", path, "--contract", "contract.json", "--out",
                                        f"report_{path.stem}").startswith("PASS"),
        "clockdoctor, ends early": "ends early" in run("clockdoctor", path),
    }


seen = {
    "whole": is_found(whole),
    "silent from 8 to 10 s": is_found(recording("paused", {*range(200)} - {*range(80, 100)})),
    "silent from 8 to 20 s": is_found(recording("unplugged", range(80))),
}
five = ["baglint", "robot-triage", "rosbag-doctor", "bagx", "backplane-tracecheck"]
last = "clockdoctor, ends early"
compare(seen, {
    "whole": {**dict.fromkeys(five, False), last: False},
    "silent from 8 to 10 s": {**dict.fromkeys(five, True), last: False},
    "silent from 8 to 20 s": {**dict.fromkeys(five, False), last: True},
})
END
