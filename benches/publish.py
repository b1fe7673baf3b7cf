"""Measures `urg publish`: publish.sh runs it, with a namespace and the readers.

publish.py PROGRAM [CASE...]: each of `rates`, `many`, `processes`, `router`, `wire`, or
all of them. Prints a row for each measurement. Latency is from the publisher's own stamp
of a message to the reader's callback; losses are gaps in the publisher's numbers. CPU
time is that of the whole `urg`, its emulated sensors included.
"""

import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

PROGRAM, CASES = sys.argv[1], sys.argv[2:]
SECONDS = 15

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
for key, value in {"mode": "router", "listen/endpoints": ["tcp/0.0.0.0:7447"],
                   "scouting/multicast/enabled": False}.items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
print("ready", flush=True)
time.sleep(3600)
"""


def cpu_of(process):
    """Returns the CPU time of a process so far, in seconds."""
    return time.clock_gettime(~process.pid << 3 | 2)


class Router:
    def __init__(self, enter=()):
        command = [*enter, sys.executable, "-c", ROUTER]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def kill(self):
        self.process.kill()
        self.process.wait()


class Reader:
    """Latencies and times of all scans, and their numbers by topic."""

    def __init__(self):
        self.clear()

    def clear(self):
        self.latencies, self.numbers, self.times = [], {}, []

    def take(self, topic, number, stamp):
        now = time.time_ns()
        self.latencies.append(now - stamp)
        self.times.append(now)
        first, _, count = self.numbers.get(topic, (number, number, 0))
        self.numbers[topic] = (first, number, count + 1)

    def lost(self):
        return sum(last - first + 1 - count for first, last, count in self.numbers.values())


class ZenohReader(Reader):
    def __init__(self, mode="client"):
        import zenoh

        super().__init__()
        config = zenoh.Config()
        settings = {"mode": mode, "connect/endpoints": ["tcp/localhost:7447"]}
        settings |= {"scouting/multicast/enabled": False, "listen/endpoints": []}
        if mode == "peer":
            settings["listen/endpoints"] = ["tcp/localhost:0"]
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)

        def take(sample):
            self.take(str(sample.key_expr), *struct.unpack_from("<qq", bytes(sample.attachment)))

        key = "*/**/sensor_msgs::msg::dds_::LaserScan_/*"
        self.subscriber = self.session.declare_subscriber(key, take)

    def close(self):
        self.session.close()


class RosReader(Reader):
    node = None

    def __init__(self, topics, qos):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import LaserScan

        super().__init__()
        if RosReader.node is None:
            rclpy.init()
            RosReader.node = rclpy.create_node("reader")
            executor = SingleThreadedExecutor()
            executor.add_node(RosReader.node)
            threading.Thread(target=executor.spin, daemon=True).start()
        profile = qos_profile_sensor_data if qos == "sensor" else QoSProfile(depth=100)

        def taker(topic):
            return lambda _, info: self.take(
                topic, info["publication_sequence_number"], info["source_timestamp"]
            )

        self.subscriptions = [
            RosReader.node.create_subscription(LaserScan, topic, taker(topic), profile, raw=True)
            for topic in topics
        ]

    def close(self):
        for subscription in self.subscriptions:
            RosReader.node.destroy_subscription(subscription)


class Urg:
    def __init__(self, *arguments, enter=()):
        self.process = subprocess.Popen(
            [*enter, PROGRAM, *map(str, arguments)],
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def memory(self):
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(text.split("VmRSS:")[1].split()[0]) / 1024

    def stop(self):
        begin = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        self.process.wait()
        return time.monotonic() - begin


def quantile(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(len(values) * part))] / 1e6 if values else float("nan")


def row(name, reader, seconds, cpu, more):
    scans = len(reader.latencies)
    load = os.getloadavg()[0]
    print(
        f"{name:34} {scans:6} scans, lost {reader.lost():5}, p50 {quantile(reader.latencies, 0.5):7.2f} ms,"
        f" p99 {quantile(reader.latencies, 0.99):7.2f} ms, CPU {1000 * cpu / max(scans, 1):.2f} ms"
        f" a scan, {100 * cpu / seconds:5.2f} % of a core, load {load:.1f} {more}",
        flush=True,
    )


def measure(name, reader, urg, topics, router=None, patience=60):
    """Waits until each topic was read, then measures for some seconds."""
    begin = time.monotonic()
    while len(reader.numbers) < topics and time.monotonic() < begin + patience:
        time.sleep(0.05)
    discovered = time.monotonic() - begin
    time.sleep(3)
    reader.clear()
    cpu, begin = cpu_of(urg.process), time.monotonic()
    routed = cpu_of(router.process) if router else 0
    time.sleep(SECONDS)
    cpu, took = cpu_of(urg.process) - cpu, time.monotonic() - begin
    more = f"{urg.memory():.0f} MiB, all {len(reader.numbers)} topics after {discovered:.1f} s"
    if router:
        routed = 1000 * (cpu_of(router.process) - routed) / max(len(reader.latencies), 1)
        more += f", router {routed:.2f} ms a scan"
    row(name, reader, took, cpu, more)


def offline(name, sensors, *options):
    """The same sensors with an engine that reaches nobody: drivers and encoding only."""
    urg = Urg("publish", *sensors, "--engine", "zenoh", *options)
    time.sleep(4)
    cpu = cpu_of(urg.process)
    time.sleep(SECONDS)
    print(f"{name:34} {(cpu_of(urg.process) - cpu) / SECONDS * 100:.2f} % of a core", flush=True)
    urg.stop()


def emulators(count, *options):
    """Starts emulated sensors of their own; returns them and their ports."""
    started = [Urg("emulate", "--tcp", 4000 + number, *options) for number in range(count)]
    time.sleep(1)
    return started, [f"s{number}=tcp://127.0.0.1:{4000 + number}" for number in range(count)]


def named(count):
    return [f"s{number}=emulated" for number in range(count)]


def both_engines(name, sensors, *options):
    topics = [f"/{sensor.split('=')[0]}/scan" for sensor in sensors]
    for qos in ("reliable", "sensor"):
        reader = RosReader(topics, qos)
        urg = Urg("publish", *sensors, "--engine", "dds", "--qos", qos, *options)
        measure(f"DDS, {qos}, {name}", reader, urg, len(topics))
        print(f"{'':34} ended within {urg.stop():.1f} s", flush=True)
        reader.close()
    router = Router()
    for qos in ("reliable", "sensor"):
        for mode in ("client", "peer"):
            reader = ZenohReader(mode)
            engine = ["--engine", "zenoh", "--qos", qos, "--mode", mode]
            urg = Urg("publish", *sensors, *engine, *options)
            measure(f"zenoh {mode}, {qos}, {name}", reader, urg, len(topics), router)
            print(f"{'':34} ended within {urg.stop():.1f} s", flush=True)
            reader.close()
    router.kill()


def rates():
    offline("no network, 1 x 10 Hz", named(1))
    both_engines("1 x 10 Hz", named(1))
    started, ports = emulators(8, "--revolution", "8ms")
    both_engines("8 x 125 Hz", ports, "--rate", "125")
    for each in started:
        each.stop()
    offline("no network, 100 x 10 Hz", named(100))
    both_engines("100 x 10 Hz", named(100))


def many():
    offline("no network, 1000 x 1 Hz", named(1000), "--rate", "1")
    both_engines("1000 x 1 Hz", named(1000), "--rate", "1")


def processes(count=100):
    """Processes with ten sensors each at 1 Hz: over zenoh through one router, over DDS
    each a participant of its own."""
    for engine in ("zenoh", "dds"):
        # More participants on two cores do not discover each other.
        hosts = [f"h{number}" for number in range(count if engine == "zenoh" else count // 10)]
        router = Router() if engine == "zenoh" else None
        topics = [f"/{host}/s{number}/scan" for host in hosts for number in range(10)]
        reader = ZenohReader() if engine == "zenoh" else RosReader(topics, "reliable")
        options = ["--topic", "scan", "--rate", "1", "--engine", engine]
        begin = time.monotonic()
        started = [Urg("publish", *named(10), "--namespace", host, *options) for host in hosts]
        while len(reader.numbers) < len(topics) and time.monotonic() < begin + 60:
            time.sleep(0.1)
        settled = time.monotonic() - begin
        time.sleep(3)
        reader.clear()
        cpu, begin = sum(cpu_of(urg.process) for urg in started), time.monotonic()
        time.sleep(SECONDS)
        cpu, took = sum(cpu_of(urg.process) for urg in started) - cpu, time.monotonic() - begin
        memory = sum(urg.memory() for urg in started)
        row(f"{engine}, {len(hosts)} processes", reader, took, cpu,
            f"{memory:.0f} MiB together, {len(reader.numbers)} topics after {settled:.1f} s")
        for urg in started:
            urg.process.send_signal(signal.SIGINT)
        for urg in started:
            urg.process.wait()
        reader.close()
        if router:
            router.kill()


def gone_for_6_s():
    """The router is killed, and is back after 6 s."""
    for mode in ("client", "peer"):
        router = Router()
        reader = ZenohReader(mode)
        urg = Urg("publish", "emulated", "--engine", "zenoh", "--mode", mode)
        while len(reader.times) < 30:
            time.sleep(0.05)
        router.kill()
        killed = time.time_ns()
        time.sleep(6)
        router = Router()
        time.sleep(15)
        gaps = [b - a for a, b in zip(reader.times, reader.times[1:]) if b > killed]
        print(f"zenoh {mode}, no router for 6 s: longest gap {max(gaps) / 1e9:.1f} s", flush=True)
        urg.stop()
        reader.close()
        router.kill()


def wire():
    """Bytes on the wire for each scan, frames of Ethernet included, in both directions,
    to one reader in another namespace, with diagnostics and what keeps the engine
    going."""
    far = subprocess.Popen(["unshare", "-n", "sleep", "600"])
    time.sleep(0.5)
    enter = ("nsenter", "-t", str(far.pid), "-n")
    run = lambda command: subprocess.run(command, shell=True, check=True)
    run(f"ip link add w0 type veth peer name w0 netns {far.pid}")
    run("ip link set w0 up; ip addr add 10.1.0.1/24 dev w0")
    run(" ".join(enter) + " sh -c 'ip link set lo up; ip link set w0 up;"
        " ip addr add 10.1.0.2/24 dev w0; ip route add 224.0.0.0/4 dev w0'")
    router = Router(enter)
    ros = "import rclpy; from rclpy.qos import *; from sensor_msgs.msg import LaserScan; rclpy.init();"
    ros += "n = rclpy.create_node('r'); s = n.create_subscription(LaserScan, '/scan', lambda _: 0,"
    ros += " qos_profile_sensor_data if QOS == 'sensor' else 10, raw=True); rclpy.spin(n)"
    zenoh = ROUTER.split("session")[0].replace('"router"', '"client"')
    zenoh = zenoh.replace('"listen/endpoints": ["tcp/0.0.0.0:7447"]',
                          '"connect/endpoints": ["tcp/localhost:7447"]')
    zenoh += "s = zenoh.open(config); r = s.declare_subscriber('*/scan/**', lambda _: 0); time.sleep(600)"

    def counters():
        values = next(l for l in Path("/proc/net/dev").read_text().splitlines() if "w0:" in l)
        values = values.split(":")[1].split()
        return int(values[0]) + int(values[8]), int(values[1]) + int(values[9])

    windows = {"44..725": [], "0..768": ["--start", 0, "--end", 768], "cluster 4": ["--cluster", 4]}
    for engine, qos in (("dds", "reliable"), ("dds", "sensor"), ("zenoh", "reliable")):
        program = zenoh if engine == "zenoh" else ros.replace("QOS", repr(qos))
        reader = subprocess.Popen([*enter, sys.executable, "-c", program])
        for window, options in windows.items():
            urg = Urg("publish", "emulated", "--engine", engine, "--qos", qos, "--interface",
                      "10.1.0.1", "--router", "tcp/10.1.0.2:7447", *options)
            time.sleep(6)
            (octets, packets), begin = counters(), time.monotonic()
            time.sleep(SECONDS)
            later, took = counters(), time.monotonic() - begin
            scans = 10 * took
            print(f"{engine}, {qos}, {window}: {(later[0] - octets) / scans:.0f} bytes,"
                  f" {(later[1] - packets) / scans:.1f} packets a scan", flush=True)
            urg.stop()
        reader.kill()
    router.kill()
    far.kill()


CHOICE = {"rates": rates, "many": many, "processes": processes, "router": gone_for_6_s, "wire": wire}
for case in CASES or CHOICE:
    CHOICE[case]()
os._exit(0)
