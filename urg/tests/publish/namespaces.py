"""Other network namespaces, and programs of Python that run in them."""

import os
import subprocess
import sys
import threading

from common import wait

ZENOH = """
import json, os, signal, struct, sys, time, zenoh
def session(mode, **settings):
    config = zenoh.Config()
    settings |= {"mode": mode, "scouting/multicast/enabled": False}
    for key, value in settings.items():
        config.insert_json5(key.replace("_", "/"), json.dumps(value))
    return zenoh.open(config)
"""

ROUTER = ZENOH + """
router = session("router", listen_endpoints=["tcp/0.0.0.0:7447"])
print("ready", flush=True)
time.sleep(86400)
"""

# Prints publisher's number and stamp in nanoseconds of each scan.
ROS_READER = """
import rclpy
from sensor_msgs.msg import LaserScan
rclpy.init()
node = rclpy.create_node("reader")
print("ready", flush=True)
def got(scan, info):
    stamp = scan.header.stamp
    print(info["publication_sequence_number"], stamp.sec * 10**9 + stamp.nanosec, flush=True)
node.create_subscription(LaserScan, "/scan", got, 100)
rclpy.spin(node)
"""


def ip(command, inside=()):
    subprocess.run([*inside, "ip", *command.split()], check=True)


class Namespace:
    """Another machine: a network, and shared memory, in which Fast DDS reports an error if
    readers of two networks open the same port. Lives as long as its process."""

    def __init__(self):
        shared_memory = "mount -t tmpfs none /dev/shm && exec sleep infinity"
        self.process = subprocess.Popen(["unshare", "-nm", "sh", "-c", shared_memory])
        own = os.readlink("/proc/self/ns/net")
        theirs = f"/proc/{self.process.pid}/ns/net"
        comm = f"/proc/{self.process.pid}/comm"
        wait("a namespace", lambda: os.readlink(theirs) != own and open(comm).read() == "sleep\n")
        self.enter = ("nsenter", "-t", str(self.process.pid), "-n", "-m")
        ip("link set lo up", self.enter)

    def link(self, name, address):
        """Adds a link to it: its end here and its end there have no address yet."""
        ip(f"link add {name} type veth peer name {name} netns {self.process.pid}")
        use(name, address, self.enter)


def use(name, address, inside=()):
    ip(f"link set {name} up", inside)
    ip(f"addr add {address}/24 dev {name}", inside)


class Lines:
    """A program of Python in a namespace, and the lines that it has printed."""

    def __init__(self, program, *arguments, namespace=None, python=sys.executable, settings=()):
        """`settings` are variables of its environment: `NAME=VALUE`."""
        enter = namespace.enter if namespace else ()
        command = ["env", *settings, *enter, python, "-c", program, *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        first = self.process.stdout.readline()
        assert first == "ready\n", f"instead of ready: {first!r}"
        self.lines = []
        threading.Thread(target=self.collect, daemon=True).start()

    def collect(self):
        for line in self.process.stdout:
            self.lines.append(line.split())

    def more(self, count=20, seconds=20):
        """Waits for so many more lines."""
        wanted = len(self.lines) + count
        wait(f"{count} lines", lambda: len(self.lines) >= wanted, seconds)

    def kill(self):
        self.process.kill()
        self.process.wait()
