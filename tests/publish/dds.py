"""Reads what `urg publish` publishes with ROS 2: rclpy on Fast DDS.

dds.py PROGRAM RECORDING
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from common import PROGRAM, RECORDING, Urg, compare, ok, wait

READER = """
import sys, time, rclpy
from sensor_msgs.msg import LaserScan
rclpy.init()
node = rclpy.create_node(sys.argv[1])
node.create_subscription(LaserScan, "/scan", lambda _: print("scan", flush=True), 20)
rclpy.spin(node)
"""

rclpy.init()
node = rclpy.create_node("observer")
RELIABLE = QoSProfile(depth=1000)
names = iter(range(1000))


def spin():
    rclpy.spin_once(node, timeout_sec=0.05)


def until(what, condition, seconds=20):
    wait(what, condition, seconds, spin)


class Reader:
    """Collects the messages of a topic."""

    def __init__(self, kind, topic, qos=RELIABLE):
        self.got = []
        self.subscription = node.create_subscription(kind, topic, self.got.append, qos)

    def close(self):
        node.destroy_subscription(self.subscription)

    def scans(self):
        stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in self.got]
        return list(zip(stamps, [list(m.ranges) for m in self.got]))


def values_of(message):
    status = message.status[0]
    return {value.key: value.value for value in status.values}


def values_are_the_same():
    for qos, reader_qos in [("reliable", RELIABLE), ("sensor", qos_profile_sensor_data)]:
        topic = f"/{qos}/scan"
        reader = Reader(LaserScan, topic, reader_qos)
        other = Reader(LaserScan, topic, RELIABLE)
        with Urg("publish", RECORDING, "--topic", topic, "--qos", qos, "--frame", "f") as urg:
            until("the recording ends", lambda: urg.process.poll() is not None, 60)
            for _ in range(10):
                spin()
        compare(f"{qos} reader", reader.scans())
        assert all(m.header.frame_id == "f" for m in reader.got)
        first = reader.got[0]
        assert abs(first.angle_increment - 0.006135923) < 1e-8 and first.scan_time == 0.10000000149011612
        assert (first.range_min, first.range_max) == (0.019999999552965164, 4.0939998626708984)
        # A reliable reader of a best-effort publisher gets nothing, as ROS has it.
        assert (len(other.got) > 0) == (qos == "reliable"), f"{qos}: {len(other.got)}"
        reader.close(), other.close()


def the_recipe_without_a_build():
    guide = Path(__file__).resolve().parents[2] / "src" / "guide" / "recipes.md"
    (recipe,) = re.findall(r"^```python\n(.*?)^```", guide.read_text(), re.M | re.S)
    reader = Reader(LaserScan, "/scan")
    output, pipe = os.pipe()
    publisher = subprocess.Popen([sys.executable, "-c", recipe], stdin=output)
    until("the recipe's publisher", lambda: node.count_publishers("/scan") == 1)
    stream = subprocess.Popen([PROGRAM, "stream", str(RECORDING)], stdout=pipe)
    os.close(output), os.close(pipe)
    until("the recipe ends", lambda: publisher.poll() is not None, 60)
    for _ in range(10):
        spin()
    stream.wait()
    compare("the recipe in Python", reader.scans())
    reader.close()


def the_graph_and_the_parameters():
    with Urg("publish", "front=emulated", "rear=emulated", "--namespace", "/robot") as urg:
        expected = {("urg_node", "/robot/front"), ("urg_node", "/robot/rear")}
        until("both nodes", lambda: expected <= set(node.get_node_names_and_namespaces()))
        topics = lambda: dict(node.get_topic_names_and_types())
        until("both topics", lambda: {"/front/scan", "/rear/scan", "/diagnostics"} <= set(topics()))
        assert topics()["/front/scan"] == ["sensor_msgs/msg/LaserScan"]
        until("a publisher", lambda: node.count_publishers("/front/scan") == 1)
        info = node.get_publishers_info_by_topic("/front/scan")[0]
        assert (info.node_name, info.node_namespace) == ("urg_node", "/robot/front"), info
        assert info.qos_profile.reliability.name == "RELIABLE"
        ok("nodes, topics and publishers of the graph")

        get = node.create_client(GetParameters, "/robot/front/urg_node/get_parameters")
        until("the parameter service", get.service_is_ready)
        future = get.call_async(GetParameters.Request(names=["frame_id", "rate", "cluster"]))
        until("the parameters", future.done)
        frame, rate, cluster = future.result().values
        assert (frame.string_value, rate.double_value, cluster.integer_value) == ("front_laser", 10.0, 1)
        change = node.create_client(SetParameters, "/robot/front/urg_node/set_parameters")
        until("the parameter service", change.service_is_ready)
        other = Parameter(name="frame_id", value=ParameterValue(type=4, string_value="x"))
        future = change.call_async(SetParameters.Request(parameters=[other]))
        until("an answer", future.done)
        result = future.result().results[0]
        assert not result.successful and "read-only" in result.reason, result
        ok("parameters can be read and not be set")
        said = urg.stop()
        assert len(said.splitlines()) == 1, f"a clean end is silent: {said}"
        until("the graph is clean", lambda: not expected & set(node.get_node_names_and_namespaces()))
        ok("Ctrl-C takes the nodes out of the graph, silently")


def a_hundred_sensors_share_a_participant():
    names = [f"s{number}" for number in range(100)]
    counts = dict.fromkeys(names, 0)

    def counter(name):
        def count(_):
            counts[name] += 1

        return count

    subscriptions = [
        node.create_subscription(LaserScan, f"/{name}/scan", counter(name), qos_profile_sensor_data, raw=True)
        for name in names
    ]
    with Urg("publish", *[f"{name}=emulated" for name in names], "--qos", "sensor"):
        until("scans of each", lambda: min(counts.values()) >= 30, 60)
        services = [name for name, _ in node.get_service_names_and_types() if "/s1/" in name]
        assert services == [], services
    for subscription in subscriptions:
        node.destroy_subscription(subscription)
    ok("a hundred sensors publish in one process")


def processes_start_in_the_same_moment():
    """Fast DDS skips announcements of endpoints that do not arrive in order."""
    hosts, names = [f"h{number}" for number in range(5)], [f"s{number}" for number in range(4)]
    topics = [f"/{host}/{name}/scan" for host in hosts for name in names]
    readers = [Reader(LaserScan, topic) for topic in topics]
    sensors = [f"{name}=emulated" for name in names]
    with ExitStack() as processes:
        for host in hosts:
            options = ["--namespace", host, "--topic", "scan", "--rate", "1"]
            processes.enter_context(Urg("publish", *sensors, *options))
        until("scans of each sensor of five processes", lambda: all(r.got for r in readers), 40)
    for reader in readers:
        reader.close()
    ok("all topics of five processes that start in the same moment are found")


def readers_come_late_die_and_hang():
    with Urg("publish", "emulated"):
        reader = Reader(LaserScan, "/scan")
        until("scans", lambda: len(reader.got) > 5)
        others = [
            subprocess.Popen(
                [sys.executable, "-c", READER, f"reader_{number}"], stdout=subprocess.PIPE, text=True
            )
            for number in range(2)
        ]
        for other in others:
            assert other.stdout.readline() == "scan\n"
        ok("late readers get scans")
        others[0].send_signal(signal.SIGKILL)
        others[1].send_signal(signal.SIGSTOP)
        begin = len(reader.got)
        until("scans go on", lambda: len(reader.got) > begin + 50)
        for other in others:
            other.kill()
            other.wait()
        stamps = [stamp for stamp, _ in reader.scans()][begin:]
        gaps = [b - a for a, b in zip(stamps, stamps[1:])]
        assert max(gaps) < 190_000_000, f"a scan is missing: {max(gaps)} ns"
        reader.close()
        ok("a reader that dies and one that hangs cost the others nothing")


def diagnostics_and_an_unplugged_sensor():
    with tempfile.TemporaryDirectory() as folder:
        port = Path(folder) / "urg"
        reader, scans = Reader(DiagnosticArray, "/diagnostics"), Reader(LaserScan, "/bad/scan")
        good = Reader(LaserScan, "/good/scan")
        level = lambda name: next(
            (m.status[0] for m in reversed(reader.got) if name in m.status[0].name), None
        )
        emulator = Urg("emulate", "--link", port)
        wait("the port", port.exists)
        with Urg("publish", f"bad={port}", "good=emulated") as urg:
            until("scans", lambda: len(scans.got) > 10 and len(good.got) > 10)
            until("all is well", lambda: level("bad") is not None and level("bad").level == b"\0")
            latest = lambda: values_of(next(m for m in reversed(reader.got) if "bad" in m.status[0].name))
            until("the rate", lambda: float(latest()["Rate reached (Hz)"]) > 9)
            values = latest()
            assert values["State"] == "connected" and values["Serial number"] == level("bad").hardware_id
            assert values["Rate requested (Hz)"] == "10"
            assert int(values["Scans published"]) > 5
            # Some may have come before the engine was open.
            dropped = values["Scans dropped"]
            emulator.kill()
            gone = time.monotonic()
            until("an error", lambda: level("bad").level == b"\2", 10)
            took = time.monotonic() - gone
            assert took < 2.5, f"an unplugged sensor was reported after {took:.1f} s"
            assert level("good").level == b"\0", level("good")
            begin = len(good.got)
            until("the other goes on", lambda: len(good.got) > begin + 10)
            port.unlink(missing_ok=True)
            emulator = Urg("emulate", "--link", port)
            begin = len(scans.got)
            until("scans again", lambda: len(scans.got) > begin + 10)
            until("all is well again", lambda: level("bad").level == b"\0")
            assert latest()["Scans dropped"] == dropped
            ok(f"an unplugged sensor is an error after {took:.1f} s, and comes back")
        emulator.kill()
        for each in (reader, scans, good):
            each.close()


values_are_the_same()
the_recipe_without_a_build()
the_graph_and_the_parameters()
a_hundred_sensors_share_a_participant()
processes_start_in_the_same_moment()
readers_come_late_die_and_hang()
diagnostics_and_an_unplugged_sensor()
os._exit(0)
