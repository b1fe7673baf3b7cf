#!/usr/bin/env bash
# ROS 2 Jazzy (rmw_fastrtps_cpp 8.4.3) lists a Cyclone DDS 11.0.1 writer that was deleted until its lease expires.
#
# Expected: the writer, and then its participant, says that it is gone, and is in no list any more: Cyclone sees that at
# once. rclpy on Fast DDS lists the publisher for another 10 s, Cyclone's lease, so a tool that counts publishers takes
# a program that has ended for one that runs. With Cyclone's option GenerateKeyhash the publisher goes at once.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess

from cyclone_writer import cyclone_writer
from place import compare, network, ros

WRITER = cyclone_writer(7, "rt/text", "std_msgs::msg::dds_::String_") + """
import gc
input()
del writer
del participant
gc.collect()
input()
"""
OBSERVER = """
import os
import sys
import time
import rclpy
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState
from cyclonedds.domain import DomainParticipant
rclpy.init()
node = rclpy.create_node("observer")
participant = DomainParticipant(7)
publications, alive = BuiltinDataReader(participant, BuiltinTopicDcpsPublication), set()
def of_fast_dds(): return node.count_publishers("text") > 0
def of_cyclone():
    for found in publications.take(1000):
        info = found.sample_info
        if info.instance_state != InstanceState.Alive: alive.discard(info.instance_handle)
        elif found.topic_name == "rt/text": alive.add(info.instance_handle)
    return bool(alive)
def wait(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end: time.sleep(0.05)
    return condition()
print(wait(lambda: of_fast_dds() and of_cyclone(), 20), flush=True)
input()
gone = [wait(lambda: not listed(), 5) for listed in (of_cyclone, of_fast_dds)]
print(*gone, wait(lambda: not of_fast_dds(), 20), flush=True)
os._exit(0)
"""
KEY_HASH = "<CycloneDDS><Domain><Internal><GenerateKeyhash>true</GenerateKeyhash></Internal></Domain></CycloneDDS>"
python = ros("ros-jazzy-rclpy==7.1.6", "ros-jazzy-std-msgs==5.3.6", "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
             "cyclonedds==11.0.1")
network()
seen = {}
for name, config in [("defaults", ""), ("GenerateKeyhash", KEY_HASH)]:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    writer = subprocess.Popen([python, "-c", WRITER], env={**os.environ, "CYCLONEDDS_URI": config}, **pipes)
    observer = subprocess.Popen([python, "-c", OBSERVER], **pipes)
    assert observer.stdout.readline() == "True\n"
    for process in [writer, observer]:
        process.stdin.write("\n")
        process.stdin.flush()
    cyclone, fast, at_last = observer.stdout.readline().split()
    writer.communicate("\n")
    seen[name] = f"gone after 5 s: Cyclone {cyclone}, Fast DDS {fast}; later: {at_last}"
compare(seen, {
    "defaults": "gone after 5 s: Cyclone True, Fast DDS False; later: True",
    "GenerateKeyhash": "gone after 5 s: Cyclone True, Fast DDS True; later: True",
})
END
