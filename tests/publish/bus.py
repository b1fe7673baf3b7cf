"""Runs the guide's recipes for NATS and MQTT, and reads what they publish.

bus.py PROGRAM RECIPES FOLDER, in a network namespace: see bus.sh
"""

import json
import math
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

PROGRAM, RECIPES, FOLDER = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
POINTS = 682


def wait(what, attempt, seconds=15):
    """Waits until `attempt` returns something. A busy machine needs the time."""
    end = time.monotonic() + seconds
    while (result := attempt()) is None:
        assert time.monotonic() < end, f"waited {seconds} s in vain: {what}"
        time.sleep(0.05)
    return result


def start(*command):
    return subprocess.Popen([str(part) for part in command], stderr=subprocess.DEVNULL)


def stop(process):
    process.kill()
    process.wait()


def connected(port):
    def attempt():
        try:
            return socket.create_connection(("localhost", port), timeout=10)
        except ConnectionRefusedError:
            return None

    return wait(f"a server on port {port}", attempt)


class Nats:
    """The text protocol of NATS, as far as a reader needs it."""

    server = ("nats-server", "--addr", "127.0.0.1")
    program = RECIPES / "nats"

    def __init__(self):
        self.stream = connected(4222).makefile("rwb")
        assert self.stream.readline().startswith(b"INFO ")
        self.stream.write(b'CONNECT {"verbose":false}\r\nSUB urg.front.scan 1\r\n')
        self.stream.flush()

    def next(self):
        """Returns the stamp and the number of points of the next scan."""
        while not (line := self.stream.readline()).startswith(b"MSG "):
            assert line, "the server has closed the connection"
        message = self.stream.read(int(line.split()[-1]) + 2)[4:]
        sec, nanosec, length = struct.unpack_from("<iII", message)
        at = 12 + length + -length % 4 + 7 * 4
        (count,) = struct.unpack_from("<I", message, at)
        ranges = struct.unpack_from(f"<{count}f", message, at + 4)
        assert sum(0.02 <= range < 4.1 for range in ranges) > POINTS / 2, ranges
        return sec + nanosec / 1e9, count


class Mqtt:
    """MQTT 3.1.1, as far as a reader needs it."""

    server = ("mosquitto", "-c", FOLDER / "mosquitto.conf")
    program = RECIPES / "mqtt"

    def __init__(self):
        self.stream = connected(1883).makefile("rwb")
        topic = b"urg/front/scan"
        self.stream.write(b"\x10\x0e\0\x04MQTT\x04\x02\0\0\0\x02me")
        self.stream.write(bytes([0x82, len(topic) + 5, 0, 1, 0, len(topic)]) + topic + b"\0")
        self.stream.flush()
        assert self.packet()[0] == 0x20 and self.packet()[0] == 0x90

    def packet(self):
        kind = self.stream.read(1)
        assert kind, "the server has closed the connection"
        length = shift = 0
        while True:
            (byte,) = self.stream.read(1)
            length |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return kind[0], self.stream.read(length)

    def next(self):
        kind, body = self.packet()
        assert kind == 0x30, kind
        scan = json.loads(body[2 + body[1] :])
        from_rear = scan["angle_min"] / math.tau + 0.5
        return scan["stamp"] - (1 - from_rear) * scan["scan_time"], len(scan["values"])


def publishes_and_survives_its_server(bus, port):
    # The server is away at the start.
    program = start(bus.program, port)
    server = start(*bus.server)
    for _ in range(2):
        reader = bus()
        scans = [reader.next() for _ in range(21)][1:]
        assert all(count == POINTS for _, count in scans), scans
        gaps = [b - a for (a, _), (b, _) in zip(scans, scans[1:])]
        assert all(0.05 < gap < 0.45 for gap in gaps), gaps
        age = time.time() - scans[-1][0]
        assert 0 < age < 1.5, f"a scan is {age} s old"
        # And later.
        stop(server)
        assert program.poll() is None
        server = start(*bus.server)
    stop(server)
    stop(program)
    print(f"ok: {bus.__name__}: scans before and after the server was away", flush=True)


# As root it would become another user, whom the namespace does not have.
settings = "listener 1883 127.0.0.1\nallow_anonymous true\nuser root\n"
(FOLDER / "mosquitto.conf").write_text(settings)
subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
port = FOLDER / "urg"
emulator = start(PROGRAM, "emulate", "--link", port)
wait("the port", lambda: port.exists() or None)
for bus in (Nats, Mqtt):
    publishes_and_survives_its_server(bus, port)
stop(emulator)
