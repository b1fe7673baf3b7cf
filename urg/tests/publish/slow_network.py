"""Publishes over zenoh to a router that hangs, and over a link that is too slow: what is
dropped must be counted, and what is counted must be missing at the reader.

slow_network.py PROGRAM RECORDING
"""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import zenoh

from common import Urg, ok, wait

SESSION = """
import json, sys, time, zenoh
config = zenoh.Config()
for key, value in json.loads(sys.argv[1]).items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
print("ready", flush=True)
time.sleep(3600)
"""
DOMAIN = os.environ["ROS_DOMAIN_ID"]


def settings(mode, **more):
    return {"mode": mode, "scouting/multicast/enabled": False, **more}


def start_router():
    config = settings("router", **{"listen/endpoints": ["tcp/localhost:7447"]})
    command = [sys.executable, "-c", SESSION, json.dumps(config)]
    router = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert router.stdout.readline() == "ready\n"
    return router


class Cdr:
    """A message as ROS 2 encodes it."""

    def __init__(self, payload):
        self.body, self.at = payload[4:], 0

    def number(self, kind="I"):
        size = struct.calcsize(kind)
        self.at += -self.at % size
        (value,) = struct.unpack_from("<" + kind, self.body, self.at)
        self.at += size
        return value

    def text(self):
        length = self.number()
        self.at += length
        return self.body[self.at - length : self.at - 1].decode()


def diagnostics(payload):
    """Returns the name of the node, and its values."""
    cdr = Cdr(payload)
    cdr.number("i"), cdr.number(), cdr.text()
    assert cdr.number() == 1, "one status"
    cdr.number("B")
    name = cdr.text().split("/")[0]
    cdr.text(), cdr.text()
    return name, {cdr.text(): cdr.text() for _ in range(cdr.number())}


class Reader:
    """The numbers of the scans of each sensor, and its latest diagnostics."""

    def __init__(self):
        config = zenoh.Config()
        for key, value in settings("client", **{"connect/endpoints": ["tcp/localhost:7447"]}).items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.numbers, self.oldest, self.values = {}, 0, {}
        scan = f"{DOMAIN}/*/scan/sensor_msgs::msg::dds_::LaserScan_/*"
        status = f"{DOMAIN}/diagnostics/diagnostic_msgs::msg::dds_::DiagnosticArray_/*"
        self.subscribers = [
            self.session.declare_subscriber(scan, self.take),
            self.session.declare_subscriber(status, self.take_status),
        ]

    def take(self, sample):
        number, stamp = struct.unpack_from("<qq", bytes(sample.attachment))
        self.oldest = max(self.oldest, time.time_ns() - stamp)
        self.numbers.setdefault(str(sample.key_expr).split("/")[1], []).append(number)

    def take_status(self, sample):
        name, values = diagnostics(bytes(sample.payload))
        self.values[name] = values

    def count(self):
        return sum(map(len, list(self.numbers.values())))

    def missing(self):
        """Returns the number of gaps: what was published before the first one counts,
        too."""
        lists = [list(numbers) for numbers in list(self.numbers.values())]
        assert all(len(set(numbers)) == len(numbers) for numbers in lists), "a scan came twice"
        return sum(max(numbers) - len(numbers) for numbers in lists)

    def total(self, key):
        return sum(int(values[key]) for values in list(self.values.values()))

    def settled(self, sensors):
        """Waits until all diagnostics are newer than now, twice."""
        for _ in range(2):
            self.values.clear()
            wait("diagnostics", lambda: len(self.values) == sensors, 40)


def a_router_that_hangs():
    router, reader = start_router(), Reader()
    options = ["--engine", "zenoh"]
    with Urg("publish", "s0=emulated", *options) as urg:
        wait("scans", lambda: reader.count() > 10)
        reader.settled(1)
        # The subscriber was there first, and the first scans may come before the router.
        assert reader.missing() == reader.total("Scans dropped"), reader.values
        for seconds in (1, 5):
            router.send_signal(signal.SIGSTOP)
            began = time.monotonic()
            if seconds > 2:
                urg.wait_for("no zenoh router answers", 10)
                noticed = time.monotonic() - began
                assert noticed < 5, f"noticed after {noticed:.1f} s"
            time.sleep(max(0, began + seconds - time.monotonic()))
            before = reader.count()
            router.send_signal(signal.SIGCONT)
            wait("scans again", lambda: reader.count() > before + 40)
            reader.settled(1)
            dropped, possibly = reader.total("Scans dropped"), reader.total("Scans possibly lost")
            # A router that was silent for longer than its lease of 2 s may close the link, with
            # the scans in it.
            assert seconds > 2 or possibly == 0, reader.values
            assert dropped <= reader.missing() <= dropped + possibly, (reader.missing(), reader.values)
        assert 10 < dropped < 60, f"{dropped} dropped"
        assert urg.read().count("network is back") == 1, urg.said
        ok(f"a router that hangs is noticed after {noticed:.1f} s, and {dropped} scans are dropped and counted")

        # It hangs, and never returns: nobody knows what it had got.
        router.send_signal(signal.SIGSTOP)
        wait("the loss", lambda: urg.read().count("no zenoh router") == 2)
        router.kill(), router.wait()
        router = start_router()
        before = reader.count()
        wait("scans again", lambda: reader.count() > before + 20, 40)
        reader.settled(1)
        lost = reader.total("Scans possibly lost") - possibly
        dropped = reader.total("Scans dropped")
        # Between the two the reader, too, looks for the new router.
        assert reader.missing() >= dropped and 10 < lost < 60, (reader.missing(), dropped, lost)
        ok(f"of a router that dies so, {lost} scans in transit are counted as possibly lost")

        router.send_signal(signal.SIGSTOP)
        wait("the loss", lambda: urg.read().count("no zenoh router") == 3)
        began = time.monotonic()
        urg.stop()
        assert time.monotonic() - began < 5, "Ctrl-C while the router hangs"
        ok("Ctrl-C ends it while the router hangs")
    router.kill(), router.wait()
    reader.session.close()


class SlowLink:
    """A TCP proxy that carries so many bytes a second to the router."""

    def __init__(self, port, rate):
        self.rate = rate
        self.listener = socket.create_server(("127.0.0.1", port))
        # What waits in the system's buffers is old, too.
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16_384)
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            near, _ = self.listener.accept()
            far = socket.create_connection(("127.0.0.1", 7447))
            threading.Thread(target=self.carry, args=(near, far, True), daemon=True).start()
            threading.Thread(target=self.carry, args=(far, near, False), daemon=True).start()

    def carry(self, source, target, is_slow):
        try:
            while piece := source.recv(4096):
                target.sendall(piece)
                if is_slow:
                    time.sleep(len(piece) / self.rate)
        except OSError:
            pass
        target.close()


def a_link_that_is_too_slow():
    router = start_router()
    # 20 sensors have 0.6 MB a second.
    link, reader = SlowLink(7448, 200_000), Reader()
    sensors = [f"s{number}=emulated" for number in range(20)]
    options = ["--engine", "zenoh", "--router", "tcp/localhost:7448", "--depth", "2"]
    with Urg("publish", *sensors, *options) as urg:
        wait("scans", lambda: reader.count() > 1000, 60)
        reader.settled(20)
        dropped = reader.total("Scans dropped")
        counts = [len(numbers) for numbers in reader.numbers.values()]
        assert len(counts) == 20 and min(counts) > max(counts) / 2, f"no turns: {counts}"
        assert dropped > 500, f"{dropped} dropped"
        # Two scans of each, and what zenoh and the system keep for the link.
        assert reader.oldest < 6e9, f"a scan came {reader.oldest / 1e9:.1f} s late"
        link.rate = 1e9
        # What waited is through: diagnostics take turns with scans.
        reader.settled(20), reader.settled(20)
        missing, dropped = reader.missing(), reader.total("Scans dropped")
        assert missing == dropped, f"{missing} missing, {dropped} counted"
        assert reader.total("Scans possibly lost") == 0
        assert len(urg.read().splitlines()) == 1, urg.said
    ok(f"over a slow link {dropped} scans are dropped and counted, the latest"
       f" {reader.oldest / 1e9:.1f} s late")
    reader.session.close()
    router.kill(), router.wait()


a_router_that_hangs()
a_link_that_is_too_slow()
os._exit(0)
