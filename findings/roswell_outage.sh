#!/usr/bin/env bash
# Two programs with roswell 0.1.0 (PyPI), ROS 2 over RustDDS, never find each other again after 60 s without network.
#
# A participant whose announcements stop is dropped after its lease, here 50 s. Expected: its next announcement makes it
# known again, as with Cyclone DDS (11.0.1, PyPI), whose programs find each other on the same network within seconds.
# Both roswells continue without a word, and the reader receives nothing, until one of them is started again.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess
import sys
import threading
import time

from cyclone_writer import cyclone_writer
from place import compare, ip, network, pypi, run

TEXT = cyclone_writer(7, "rt/text", "std_msgs::msg::dds_::String_")
PROGRAMS = {
    "Cyclone DDS": (TEXT, TEXT + """
from cyclonedds.sub import DataReader
reader = DataReader(participant, Topic(participant, "rt/text", Text), qos=qos)
while True:
    if reader.take(10): print("text", flush=True)
    time.sleep(0.1)
"""),
    "roswell": ("""
import roswell
node = roswell.Node("writer", domain=8)
publisher = node.publisher("/text", node.load_type("std_msgs/msg/String.msg"))
def write():
    message = publisher.new()
    message.data = "hello"
    publisher.publish(message)
""", """
import roswell
node = roswell.Node("reader", domain=8)
subscriber = node.subscribe("/text", node.load_type("std_msgs/msg/String.msg"))
while True:
    if subscriber.take(): print("text", flush=True)
    time.sleep(0.05)
"""),
}
os.environ["PYTHONPATH"] = str(pypi("roswell==0.1.0", "cyclonedds==11.0.1"))
network()


def collect(output, times):
    for _ in output:
        times.append(time.monotonic())


def read(name, reader):
    process = run(sys.executable, "-c", "import time\n" + reader, stdout=subprocess.PIPE)
    received[name] = []
    threading.Thread(target=collect, args=(process.stdout, received[name]), daemon=True).start()


received = {}
for name, (writer, reader) in PROGRAMS.items():
    read(name, reader)
    run(sys.executable, "-c", writer + "\nimport time\nwhile True:\n    write()\n    time.sleep(0.1)\n")
time.sleep(15)
ip("link", "set", "lo", "down")
before = {name: bool(times) for name, times in received.items()}
time.sleep(60)
ip("link", "set", "lo", "up")
ip("route", "replace", "224.0.0.0/4", "dev", "lo")
up = time.monotonic()
time.sleep(45)
read("roswell, started again", PROGRAMS["roswell"][1])
time.sleep(15)
seen = {name: {"received before": before.get(name), "received after": any(at > up for at in times)}
        for name, times in received.items()}
compare(seen, {
    "Cyclone DDS": {"received before": True, "received after": True},
    "roswell": {"received before": True, "received after": False},
    "roswell, started again": {"received before": None, "received after": True},
})
END
