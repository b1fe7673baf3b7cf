"""Publishes 100 emulated sensors from one process, quality of service `sensor`, and counts for
each topic what a reader misses.

hundred_sensors.py PROGRAM RECORDING ENGINE [SECONDS]

ENGINE is `dds`, read with rclpy on Fast DDS, or `zenoh`. If the reader does not get a number of
the publisher, that message was lost. If a stamp is missing from the grid of 100 ms but no number,
the driver skipped a poll on a busy machine.
"""

import os
import struct
import sys
import time

from common import Urg, wait
from namespaces import ROUTER, Lines

ENGINE = sys.argv[3]
SECONDS = float(sys.argv[4]) if len(sys.argv) > 4 else 60
SENSORS, PERIOD = 100, 100_000_000
TOPICS = [f"s{number}/scan" for number in range(SENSORS)]

# For each topic: the publisher's number and the stamp of each scan.
got = {topic: [] for topic in TOPICS}
keep = []


def stamp_of(message):
    sec, nanosec = struct.unpack_from("<iI", message, 4)
    return sec * 1_000_000_000 + nanosec


def read_dds():
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan

    rclpy.init()
    node = rclpy.create_node("reader")
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)

    def take(topic):
        return lambda message, info: got[topic].append((info["publication_sequence_number"], stamp_of(message)))

    for topic in TOPICS:
        node.create_subscription(LaserScan, f"/{topic}", take(topic), qos_profile_sensor_data, raw=True)
    return lambda: executor.spin_once(timeout_sec=0.05)


def read_zenoh():
    import zenoh

    router = Lines(ROUTER)
    config = zenoh.Config()
    for key, value in (("mode", '"client"'), ("connect/endpoints", '["tcp/localhost:7447"]'),
                       ("scouting/multicast/enabled", "false")):
        config.insert_json5(key, value)
    session = zenoh.open(config)

    def take(sample):
        (number,) = struct.unpack_from("<q", bytes(sample.attachment))
        topic = "/".join(str(sample.key_expr).split("/")[1:3])
        got[topic].append((number, stamp_of(bytes(sample.payload))))

    keep.extend((router, session, session.declare_subscriber("*/*/scan/**", take)))
    return lambda: time.sleep(0.05)


step = {"dds": read_dds, "zenoh": read_zenoh}[ENGINE]()
sensors = [f"{topic.split('/')[0]}=emulated" for topic in TOPICS]
with Urg("publish", *sensors, "--engine", ENGINE, "--qos", "sensor"):
    wait("a scan of each sensor", lambda: all(got.values()), 60, step)
    # Discovery of the last topics takes CPU time from the others.
    settle = time.monotonic() + 3
    while time.monotonic() < settle:
        step()
    for scans in got.values():
        scans.clear()
    load, end = os.getloadavg()[0], time.monotonic() + SECONDS
    while time.monotonic() < end:
        step()
    scans, lost, skipped = sum(map(len, got.values())), 0, 0
    newest = max(stamp for each in got.values() for _, stamp in each)
    for topic in TOPICS:
        last = got[topic][-1][1] if got[topic] else 0
        assert last > newest - 20 * PERIOD, f"{topic} has stopped"
        for (before, earlier), (number, later) in zip(got[topic], got[topic][1:]):
            lost += number - before - 1
            skipped += round((later - earlier) / PERIOD) - 1
print(f"{ENGINE}: {scans} scans of {SENSORS} sensors in {SECONDS:g} s: {lost} numbers and {skipped} stamps missing;"
      f" load {load:.1f} to {os.getloadavg()[0]:.1f}", flush=True)
assert not lost, f"{lost} messages were lost"
os._exit(0)
