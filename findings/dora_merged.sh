#!/usr/bin/env bash
# dora 1.1.0 (PyPI): in a node that merges a ROS 2 topic, `queue_size: 1` does not hold, and its scans are 6 s old.
#
# `queue_size` is "Input buffer size", and drops the oldest. Expected of 1, with 40 scans a second and a node that takes
# 0.1 s for each: the newest scan, as a node gets that reads its inputs alone. But after `merge_external_events`, even
# with a silent topic, inputs pass by that queue. They wait in one for 64 events or more, which drops the newest. The
# warning then advises to "raise this input's queue_size": with 128 the scans are 12 s old.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import statistics
import subprocess
import sys

from place import PLACE, compare, network, pypi

SOURCE = """
import time

import pyarrow
from dora import Node

node = Node()
time.sleep(1)
for number in range(400):
    node.send_output("scan", pyarrow.array([number]), {"sent": time.monotonic()})
    time.sleep(0.025)
"""
READER = """
import sys
import time

from dora import Node, Ros2Context, Ros2NodeOptions, Ros2QosPolicies

name, merged = sys.argv[1:]
node = Node()
if merged == "True":
    ros = Ros2Context(ros_paths=["ros"]).new_node(name, "/test", Ros2NodeOptions())
    topic = ros.create_topic("/silent", "std_msgs/Bool", Ros2QosPolicies())
    node.merge_external_events(ros.create_subscription(topic))
for event in node:
    if event["type"] == "STOP":
        break
    if event["type"] == "INPUT":
        with open(name + ".delays", "a") as file:
            print(time.monotonic() - event["metadata"]["sent"], file=file)
        time.sleep(0.1)
"""
READERS = {"alone": (False, 1), "merged": (True, 1), "larger": (True, 128)}

packages = pypi("dora-rs==1.1.0", "dora-rs-cli==1.1.0", "pyarrow==26.0.1")
(PLACE / "source.py").write_text(SOURCE)
(PLACE / "reader.py").write_text(READER)
(PLACE / "ros/std_msgs/msg").mkdir(parents=True)
(PLACE / "ros/std_msgs/package.xml").write_text("<package><name>std_msgs</name></package>")
(PLACE / "ros/std_msgs/msg/Bool.msg").write_text("bool data\n")
flow = ["nodes:", "  - {id: source, path: source.py, outputs: [scan]}"]
for name, (merged, size) in READERS.items():
    scan = f"{{source: source/scan, queue_size: {size}}}"
    flow.append(f"  - {{id: {name}, path: reader.py, args: {name} {merged}, inputs: {{scan: {scan}}}}}")
(PLACE / "flow.yml").write_text("\n".join(flow))
# dora starts its nodes with the `python` that it finds.
(PLACE / "bin").mkdir()
(PLACE / "bin/python").symlink_to(sys.executable)
os.environ["PATH"] = f"{PLACE}/bin:{packages}/bin:{os.environ['PATH']}"
os.environ["PYTHONPATH"] = str(packages)
network()
subprocess.run(["dora", "run", "flow.yml"], cwd=PLACE, check=True, capture_output=True, timeout=120)

seen = {}
for name in READERS:
    delays = [float(line) for line in (PLACE / f"{name}.delays").read_text().splitlines()]
    delay = statistics.median(delays[-20:])
    seen[f"{name}: seconds, at least"] = next(seconds for seconds in [12, 6, 0] if delay >= seconds)
compare(seen, dict(zip(seen, [0, 6, 12])))
END
