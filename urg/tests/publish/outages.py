"""Publishes through outages: the link is down, or a program is stopped, for a time; the
readers must get scans again, and few old ones.

outages.py PROGRAM RECORDING ENGINE SECONDS...

Each case has namespaces of its own for `urg`, a switch, and the readers, and all cases run at
the same time. Readers: ROS 2 Jazzy and Kilted over DDS, a client of a router over zenoh. Run
it with a Python that has none of them: theirs change the environment of other programs.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from common import Urg, wait
from namespaces import ROUTER, ZENOH, Lines, Namespace, ip, use

ENGINE, SECONDS = sys.argv[3], [float(text) for text in sys.argv[4:]]
PEERS = Path(os.environ["URG_PEERS"])
RATE, DEPTH = 10, 20

# Prints, for each scan: when it came, and its stamp.
ROS_READER = """
import sys, time, rclpy
from sensor_msgs.msg import LaserScan
from rclpy.qos import QoSProfile
rclpy.init()
node = rclpy.create_node("reader")
def got(scan):
    stamp = scan.header.stamp
    nodes = [name for name in node.get_node_names() if name == "urg_node"]
    print(time.time(), stamp.sec + stamp.nanosec / 1e9, len(nodes), flush=True)
node.create_subscription(LaserScan, "/scan", got, QoSProfile(depth=100))
print("ready", flush=True)
rclpy.spin(node)
"""

ZENOH_READER = ZENOH + """
reader = session("client", connect_endpoints=["tcp/10.1.0.2:7447"], listen_endpoints=[])
def got(sample):
    stamp = struct.unpack_from("<iI", bytes(sample.payload), 4)
    print(time.time(), stamp[0] + stamp[1] / 1e9, 1, flush=True)
subscriber = reader.declare_subscriber("*/scan/**", got)
print("ready", flush=True)
time.sleep(86400)
"""


class Place:
    """`urg` and its readers, each on a link of its own to a switch."""

    def __init__(self, name, depth=DEPTH, only=None):
        self.switch, self.robot, self.desk = Namespace(), Namespace(), Namespace()
        ip("link add br0 type bridge", self.switch.enter)
        ip("link set br0 up", self.switch.enter)
        for place, address in ((self.robot, "10.1.0.1"), (self.desk, "10.1.0.2")):
            port = f"p{address[-1]}"
            ip(f"link add {port} type veth peer name n0 netns {place.process.pid}", self.switch.enter)
            ip(f"link set {port} master br0 up", self.switch.enter)
            use("n0", address, place.enter)
            ip("route add 224.0.0.0/4 dev n0", place.enter)
        options = ["--engine", ENGINE, "--depth", depth, "--rate", RATE]
        self.router = None
        if ENGINE == "zenoh":
            python = str(PEERS / "jazzy" / "bin" / "python")
            self.router = Lines(ROUTER, namespace=self.desk, python=python)
            options += ["--router", "tcp/10.1.0.2:7447"]
        self.start = lambda: Urg("publish", "emulated", *options, enter=self.robot.enter)
        self.urg = self.start()
        self.readers = {}
        if ENGINE == "dds":
            for distro in [only] if only else ["jazzy", "kilted"]:
                python = str(PEERS / distro / "bin" / "python")
                self.readers[distro] = Lines(ROS_READER, namespace=self.desk, python=python)
        else:
            self.readers["zenoh"] = Lines(ZENOH_READER, namespace=self.desk, python=python)
        self.flows(60)

    def flows(self, seconds=20):
        for reader in self.readers.values():
            reader.more(10, seconds)

    def close(self):
        said = self.urg.stop()
        for each in (*self.readers.values(), self.router, self.switch, self.robot, self.desk):
            if each:
                each.process.kill()
                each.process.wait()
        return said


def link_of_urg(place, seconds):
    ip("link set n0 down", place.robot.enter)
    time.sleep(seconds)
    ip("link set n0 up", place.robot.enter)
    ip("route replace 224.0.0.0/4 dev n0", place.robot.enter)


def link_of_readers(place, seconds):
    ip("link set n0 down", place.desk.enter)
    time.sleep(seconds)
    ip("link set n0 up", place.desk.enter)
    ip("route replace 224.0.0.0/4 dev n0", place.desk.enter)


def switch(place, seconds):
    """Both links stay up."""
    ip("link set p1 nomaster", place.switch.enter)
    time.sleep(seconds)
    ip("link set p1 master br0", place.switch.enter)


def readers_stopped(place, seconds):
    for reader in place.readers.values():
        reader.process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    for reader in place.readers.values():
        reader.process.send_signal(signal.SIGCONT)


def urg_stopped(place, seconds):
    # `nsenter` becomes the program.
    place.urg.process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    place.urg.process.send_signal(signal.SIGCONT)


def urg_killed(place, seconds):
    place.urg.kill()
    time.sleep(seconds)
    place.urg = place.start()


def address_gone(place, seconds):
    ip("addr del 10.1.0.1/24 dev n0", place.robot.enter)
    time.sleep(seconds)
    ip("addr add 10.1.0.1/24 dev n0", place.robot.enter)
    ip("route replace 224.0.0.0/4 dev n0", place.robot.enter)


def judge(reader, begin, end, depth, strict):
    """Returns what the reader saw of the outage, and fails if that is too bad."""
    scans = lambda: [tuple(map(float, line)) for line in list(reader.lines)]
    after = lambda: [scan for scan in scans() if scan[0] >= end]
    new = lambda: [scan for scan in after() if scan[1] >= end - 0.2]
    wait("scans after the outage", lambda: len(new()) >= 30, 20)
    back = new()[0][0] - end
    # Scans that a busy machine delays after the outage do not count.
    burst = [scan for scan in after() if scan[0] - scan[1] > 0.5 and scan[1] < end - 0.2]
    # `urg` may be stopped with one scan on its way.
    on_its_way = [scan for scan in burst if scan[1] < begin]
    if strict and len(on_its_way) == 1:
        burst.remove(on_its_way[0])
    oldest = max((scan[0] - scan[1] for scan in burst), default=0)
    gaps = [b[0] - a[0] for a, b in zip(new(), new()[1:])]
    node = next((scan[0] - end for scan in after() if scan[2] >= 1), 99)
    text = f"back after {back:.1f} s, {len(burst)} old, oldest {oldest:.1f} s, node after {node:.1f} s"
    assert back < 10, text
    assert node < 10, text
    if strict:
        assert len(burst) <= depth + 1, text
        assert oldest < depth / RATE + 2, text
    assert max(gaps) < 2, f"{text}, a gap of {max(gaps):.1f} s"
    return text


def run(kind, seconds, depth, failures):
    name = f"{kind.__name__} {seconds:g} s" + (f", depth {depth}" if depth != DEPTH else "")
    try:
        place = Place(name, depth)
        begin = time.time()
        kind(place, seconds)
        end = time.time()
        # A reader that was stopped has scans in its own buffers.
        strict = kind is not readers_stopped
        seen = {distro: judge(reader, begin, end, depth, strict) for distro, reader in place.readers.items()}
        lines = len(place.close().splitlines())
        for distro, text in seen.items():
            print(f"ok: {ENGINE}, {name}, {distro}: {text}; urg wrote {lines} lines", flush=True)
    except BaseException as error:
        failures.append(name)
        print(f"FAILED: {ENGINE}, {name}: {error!r}", flush=True)


KINDS = [link_of_urg, link_of_readers, switch, readers_stopped, urg_stopped, urg_killed, address_gone]


def main():
    cases = [(kind, seconds, DEPTH) for seconds in SECONDS for kind in KINDS]
    # Ctrl-Z and `fg`; and the smallest depth.
    cases += [(urg_stopped, 0.2, DEPTH), (switch, 10, 1)]
    failures = []
    threads = []
    for kind, seconds, depth in cases:
        threads.append(threading.Thread(target=run, args=(kind, seconds, depth, failures)))
        threads[-1].start()
        # Starting is what costs.
        time.sleep(2)
    for thread in threads:
        thread.join()
    assert not failures, failures


if __name__ == "__main__":
    main()
    os._exit(0)
