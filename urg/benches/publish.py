"""Measures `urg publish`: publish.sh runs it, with a namespace and the readers.

publish.py PROGRAM [CASE...]: each of `one`, `fast`, `eight`, `hundred`, `thousand`,
`listeners`, `processes`, `load`, `router`, `wire`, or all of them. ENGINE=dds or ENGINE=zenoh
(an environment variable) leaves the other out. Prints a row for each measurement: medians of RUNS runs (an environment variable, 1 unless set) of 15 s, and the
sum of what was lost. Latency is from the publisher's own stamp of a message to the
reader's callback; losses are gaps in the publisher's numbers. CPU time is that of the
whole `urg`, its emulated sensors included.
"""

import json
import os
import signal
import struct
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

PROGRAM, CASES = sys.argv[1], sys.argv[2:]
SECONDS = 15
RUNS = int(os.environ.get("RUNS", 1))
ENGINES = os.environ.get("ENGINE", "dds zenoh").split()

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


def memory_of(process):
    """Returns the resident memory of a process, in MiB."""
    text = Path(f"/proc/{process.pid}/status").read_text()
    return int(text.split("VmRSS:")[1].split()[0]) / 1024


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
    def __init__(self, topics, qos):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import LaserScan

        super().__init__()
        # A context of its own: nothing of an earlier reader is left in the next one.
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("reader", context=self.context)
        profile = qos_profile_sensor_data if qos == "sensor" else QoSProfile(depth=100)

        def taker(topic):
            return lambda _, info: self.take(
                topic, info["publication_sequence_number"], info["source_timestamp"]
            )

        for topic in topics:
            self.node.create_subscription(LaserScan, topic, taker(topic), profile, raw=True)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.is_open = True
        self.thread = threading.Thread(target=self.spin, daemon=True)
        self.thread.start()

    def spin(self):
        while self.is_open:
            self.executor.spin_once(timeout_sec=0.1)

    def close(self):
        self.is_open = False
        self.thread.join()
        self.node.destroy_node()
        self.context.shutdown()


class Urg:
    def __init__(self, *arguments, enter=()):
        self.process = subprocess.Popen(
            [*enter, PROGRAM, *map(str, arguments)],
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def stop(self):
        begin = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        self.process.wait()
        return time.monotonic() - begin


def quantile(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(len(values) * part))] / 1e6 if values else float("nan")


def row(name, runs):
    """Prints the medians of runs, each a dictionary of figures."""
    median = lambda key: statistics.median(run[key] for run in runs)
    total = lambda key: sum(run[key] for run in runs)
    p99 = [run["p99"] for run in runs]
    text = f"{name:36} lost {total('lost')} of {total('scans')}, p50 {median('p50'):.2f} ms,"
    text += f" p99 {median('p99'):.2f} ms ({min(p99):.2f} to {max(p99):.2f}),"
    text += f" CPU {median('cpu'):.3f} ms a scan, {median('share'):.1f} % of a core,"
    text += f" {median('rate'):.0f} scans/s, load {os.getloadavg()[0]:.0f}"
    for key, unit in (("memory", "MiB"), ("discovered", "s until all were read"),
                      ("routed", "ms a scan in the router"), ("router", "MiB of the router"),
                      ("stopped", "s to stop")):
        if key in runs[0]:
            text += f", {median(key):.3g} {unit}"
    print(text, flush=True)


def watch(reader, processes, router=None):
    """Measures for some seconds, and returns the figures."""
    reader.clear()
    used = lambda: sum(cpu_of(each.process) for each in processes)
    cpu, begin = used(), time.monotonic()
    routed = cpu_of(router.process) if router else 0
    time.sleep(SECONDS)
    cpu, took = used() - cpu, time.monotonic() - begin
    scans = len(reader.latencies)
    figures = {
        "scans": scans, "lost": reader.lost(), "rate": scans / took,
        "p50": quantile(reader.latencies, 0.5), "p99": quantile(reader.latencies, 0.99),
        "cpu": 1000 * cpu / max(scans, 1), "share": 100 * cpu / took,
        "memory": sum(memory_of(each.process) for each in processes),
    }
    if router:
        figures["router"] = memory_of(router.process)
        figures["routed"] = 1000 * (cpu_of(router.process) - routed) / max(scans, 1)
    return figures


def discover(reader, topics, patience=60):
    """Waits until each topic was read; returns the seconds that it took."""
    begin = time.monotonic()
    while len(reader.numbers) < topics and time.monotonic() < begin + patience:
        time.sleep(0.05)
    return time.monotonic() - begin


def measure(reader, sensors, options, topics=None, router=None):
    """Publishes and measures once all topics are read."""
    urg = Urg("publish", *sensors, *options)
    discovered = discover(reader, topics or len(sensors))
    time.sleep(3)
    figures = watch(reader, [urg], router) | {"discovered": discovered}
    figures["stopped"] = urg.stop()
    reader.close()
    return figures


def offline(name, sensors, *options):
    """The same sensors with an engine that reaches nobody: drivers and encoding only."""
    shares = []
    for _ in range(RUNS):
        urg = Urg("publish", *sensors, "--engine", "zenoh", *options)
        time.sleep(4)
        cpu = cpu_of(urg.process)
        time.sleep(SECONDS)
        shares.append((cpu_of(urg.process) - cpu) / SECONDS * 100)
        urg.stop()
    print(f"{name:36} {statistics.median(shares):.2f} % of a core", flush=True)


def emulators(count, *options):
    """Starts emulated sensors of their own; returns them and their ports."""
    started = [Urg("emulate", "--tcp", 4000 + number, *options) for number in range(count)]
    time.sleep(1)
    return started, [f"s{number}=tcp://127.0.0.1:{4000 + number}" for number in range(count)]


def named(count):
    return [f"s{number}=emulated" for number in range(count)]


def dds(name, sensors, qos, *options, heard=None):
    """`heard` are the sensors that are read; all of them without it."""
    topics = [f"/{sensor.split('=')[0]}/scan" for sensor in heard or sensors]
    options = ["--engine", "dds", "--qos", qos, *options]
    run = lambda: measure(RosReader(topics, qos), sensors, options, len(topics))
    row(f"DDS, {qos}, {name}", [run() for _ in range(RUNS)])


def over_zenoh(name, sensors, mode, *options):
    router = Router()
    options = ["--engine", "zenoh", "--mode", mode, *options]
    run = lambda: measure(ZenohReader(mode), sensors, options, router=router)
    row(f"zenoh {mode}, {name}", [run() for _ in range(RUNS)])
    router.kill()


def both_engines(name, sensors, *options):
    """Over zenoh the quality of service is only a note to the readers."""
    for qos in ("reliable", "sensor") if "dds" in ENGINES else ():
        dds(name, sensors, qos, *options)
    for mode in ("client", "peer") if "zenoh" in ENGINES else ():
        over_zenoh(name, sensors, mode, *options)


def one():
    offline("no network, 1 x 10 Hz", named(1))
    both_engines("1 x 10 Hz", named(1))


def fast():
    """One sensor whose motor makes 1,000 revolutions a second, on a link without a baud
    rate."""
    started, ports = emulators(1, "--revolution", "1ms")
    both_engines("1 x 1000 Hz", ports, "--rate", "1000")
    for each in started:
        each.stop()


def eight():
    started, ports = emulators(8, "--revolution", "8ms")
    both_engines("8 x 125 Hz", ports, "--rate", "125")
    for each in started:
        each.stop()


def hundred():
    offline("no network, 100 x 10 Hz", named(100))
    both_engines("100 x 10 Hz", named(100))


def thousand():
    offline("no network, 1000 x 1 Hz", named(1000), "--rate", "1")
    both_engines("1000 x 1 Hz", named(1000), "--rate", "1")


def listeners():
    """1,000 sensors over DDS, of which fewer and fewer are read."""
    for count in (1000, 300, 100, 10):
        heard = named(1000)[:: 1000 // count][:count]
        dds(f"1000 x 1 Hz, {count} read", named(1000), "reliable", "--rate", "1", heard=heard)


def processes():
    """Processes with ten sensors each at 1 Hz: over zenoh through one router, over DDS
    each a participant of its own, started in the same moment and with a gap, in seconds."""
    dds = [("dds", 5, 0), ("dds", 10, 0), ("dds", 20, 0), ("dds", 20, 0.5), ("dds", 40, 0),
           ("dds", 40, 0.5)]
    for engine, count, gap in [("zenoh", 100, 0), *dds]:
        hosts = [f"h{number}" for number in range(count)]
        router = Router() if engine == "zenoh" else None
        topics = [f"/{host}/s{number}/scan" for host in hosts for number in range(10)]
        reader = ZenohReader() if engine == "zenoh" else RosReader(topics, "reliable")
        options = ["--topic", "scan", "--rate", "1", "--engine", engine]
        started = []
        for host in hosts:
            started.append(Urg("publish", *named(10), "--namespace", host, *options))
            time.sleep(gap)
        discovered = discover(reader, len(topics), 20 if engine == "dds" else 120)
        print(f"{engine}, {count} processes, {gap} s apart: {len(reader.numbers)} of {len(topics)} topics after"
              f" {discovered:.1f} s, with {sum(cpu_of(urg.process) for urg in started):.1f} s of CPU"
              " time", flush=True)
        time.sleep(3)
        row(f"{engine}, {count} processes", [watch(reader, started, router)])
        for urg in started:
            urg.process.send_signal(signal.SIGINT)
        for urg in started:
            urg.process.wait()
        reader.close()
        if router:
            router.kill()


def load():
    """What a router carries to one reader."""
    for count, rate in ((100, 10), (300, 10), (1000, 1), (1000, 2), (1000, 5)):
        over_zenoh(f"{count} x {rate} Hz", named(count), "client", "--rate", rate)


def gone_for_6_s():
    """The router is killed, and is back after 6 s."""
    for mode in ("client", "peer") * RUNS:
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
    # Else the counters take a burst of segments of TCP for one packet.
    for place in ((), enter):
        run(" ".join(place) + " ip link set w0 gso_max_segs 1")
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

    windows = {"44..725": (10, []), "0..768": (10, ["--window", "full"]),
               "cluster 4": (10, ["--cluster", 4]), "44..725 at 1 Hz": (1, ["--rate", 1])}
    for engine, qos in (("zenoh", "reliable"), ("dds", "reliable"), ("dds", "sensor")):
        if engine not in ENGINES:
            continue
        program = zenoh if engine == "zenoh" else ros.replace("QOS", repr(qos))
        reader = subprocess.Popen([*enter, sys.executable, "-c", program])
        for window, (rate, options) in windows.items():
            place = ["--router", "tcp/10.1.0.2:7447"] if engine == "zenoh" else []
            urg = Urg("publish", "emulated", "--engine", engine, "--qos", qos, "--interface",
                      "10.1.0.1", *place, *options)
            time.sleep(6)
            (octets, packets), begin = counters(), time.monotonic()
            time.sleep(SECONDS)
            later, took = counters(), time.monotonic() - begin
            scans = rate * took
            print(f"{engine}, {qos}, {window}: {(later[0] - octets) / scans:.0f} bytes,"
                  f" {(later[1] - packets) / scans:.1f} packets a scan", flush=True)
            urg.stop()
        reader.kill()
    router.kill()
    far.kill()


CHOICE = {"one": one, "fast": fast, "eight": eight, "hundred": hundred, "thousand": thousand,
          "listeners": listeners, "processes": processes, "load": load, "router": gone_for_6_s,
          "wire": wire}
for case in CASES or CHOICE:
    CHOICE[case]()
os._exit(0)
