"""Runs the examples for NATS and MQTT, and reads what they publish.

bus.py PROGRAM EXAMPLES FOLDER, in a network namespace: see bus.sh
"""

import json
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

PROGRAM, EXAMPLES, FOLDER = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
# Of a UST-10LX: 14 kB of JSON. Some clients refuse packets that are larger than their default.
POINTS = 1081


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
    program = EXAMPLES / "nats"

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
        assert sum(0.06 <= range < 30 for range in ranges) > POINTS / 2, ranges
        return sec + nanosec / 1e9, count


class Mqtt:
    """MQTT 3.1.1, as far as a reader needs it."""

    server = ("mosquitto", "-c", FOLDER / "mosquitto.conf")
    program = EXAMPLES / "mqtt"

    def __init__(self):
        self.stream = connected(1883).makefile("rwb")
        # A clean session without keepalive, and the topic with QoS 0.
        self.request(0x10, b"\0\4MQTT\4\2\0\0" + self.text(b"reader"))
        assert self.packet() == (0x20, b"\0\0")
        self.request(0x82, b"\0\1" + self.text(b"urg/front/scan") + b"\0")
        assert self.packet() == (0x90, b"\0\1\0")

    @staticmethod
    def text(text):
        return struct.pack(">H", len(text)) + text

    def request(self, kind, body):
        self.stream.write(bytes([kind, len(body)]) + body)
        self.stream.flush()

    def packet(self):
        """Returns the first byte of the next packet, and what follows its length."""
        kind, length, shift, more = self.read(1)[0], 0, 0, True
        while more:
            byte = self.read(1)[0]
            length |= (byte & 0x7F) << shift
            shift += 7
            more = byte >= 0x80
        return kind, self.read(length)

    def read(self, length):
        data = self.stream.read(length)
        assert len(data) == length, "the server has closed the connection"
        return data

    def next(self):
        """Returns the stamp and the number of points of the next scan."""
        kind, body = self.packet()
        topic = self.text(b"urg/front/scan")
        assert kind == 0x30 and body.startswith(topic), (kind, body[:40])
        scan = json.loads(body[len(topic) :])
        ranges = [range for range in scan["ranges"] if range is not None]
        assert sum(0.06 <= range < 30 for range in ranges) > POINTS / 2, scan
        return scan["stamp"], len(scan["ranges"])


def publishes_and_survives_its_server(bus, port):
    # The server is away at the start.
    program = start(bus.program, port)
    server = start(*bus.server)
    for _ in range(2):
        reader = bus()
        scans = [reader.next() for _ in range(21)][1:]
        assert all(count == POINTS for _, count in scans), scans
        gaps = [b - a for (a, _), (b, _) in zip(scans, scans[1:])]
        assert all(0 < gap < 0.45 for gap in gaps), gaps
        age = time.time() - scans[-1][0]
        assert 0 < age < 1.5, f"a scan is {age} s old"
        # It goes away later, too.
        stop(server)
        assert program.poll() is None
        server = start(*bus.server)
    stop(server)
    stop(program)
    print(f"ok: {bus.__name__}: scans before and after the server was away", flush=True)


subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
# Without a configuration it would run as a user that this namespace does not have.
Mqtt.server[2].write_text("listener 1883 127.0.0.1\nallow_anonymous true\nuser root\n")
for bus in (Nats, Mqtt):
    # A sensor for each: the system keeps a pseudo-terminal exclusive after its user was
    # killed, because the emulated sensor has it open, too.
    port = FOLDER / bus.__name__
    emulator = start(PROGRAM, "emulate", "--model", "ust-10lx", "--link", port)
    wait("the port", lambda: port.exists() or None)
    publishes_and_survives_its_server(bus, port)
    stop(emulator)
