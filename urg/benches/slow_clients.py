#!/usr/bin/env python3
"""Measures what `urg serve` does while slow clients hold its connections open.

    cargo build --release -p urg
    python3 benches/slow_clients.py target/release/urg

Two attacks, each a minute: 300 clients that send a request byte by byte, one byte a
second; and 200 that ask for /scans and never read. Then both again, where clients that
the server closes come back a second later.

Prints the memory of the server (resident, from /proc: Linux) before, during and after,
the times of /health, and the time until a new viewer has its first scan. Ends with 1 if
in the first two /health takes more than 2 s, or the first scan more than 5 s.
"""

import http.client
import json
import re
import socket
import subprocess
import sys
import threading
import time

SPAN = 60
REQUEST = b"GET /scans HTTP/1.1\r\nHost: localhost\r\nX-Slow: " + b"x" * 200


def resident(pid):
    with open(f"/proc/{pid}/status") as status:
        return int(re.search(r"VmRSS:\s+(\d+) kB", status.read())[1]) / 1024


def timed(work):
    began = time.monotonic()
    work()
    return time.monotonic() - began


class Server:
    def __init__(self, program):
        arguments = [program, "serve", "emulated", "--listen", "0"]
        self.process = subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True)
        notice = self.process.stderr.readline()
        self.port = int(re.search(r"127\.0\.0\.1:(\d+)", notice)[1])
        self.viewer = "127.0.0.1"
        threading.Thread(target=self.process.stderr.read, daemon=True).start()

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port), timeout=60)

    def get(self, path):
        source = (self.viewer, 0)
        connection = http.client.HTTPConnection(
            "127.0.0.1", self.port, timeout=60, source_address=source
        )
        connection.request("GET", path)
        return connection, connection.getresponse()

    def health(self):
        connection, response = self.get("/health")
        assert response.status == 200, response.status
        response.read()
        connection.close()

    def first_scan(self):
        connection, response = self.get("/scans?max=1")
        assert response.status == 200, response.status
        assert "ranges" in json.loads(response.readline())
        connection.close()

    def resident(self):
        return resident(self.process.pid)


class Attack(threading.Thread):
    """Keeps `count` connections open, and if asked opens another for each that is closed."""

    def __init__(self, server, count, is_slow, comes_back):
        super().__init__(daemon=True)
        self.server, self.count = server, count
        self.is_slow, self.comes_back = is_slow, comes_back
        self.is_over = threading.Event()
        self.opened = 0

    def open(self):
        client = self.server.connect()
        self.opened += 1
        if not self.is_slow:
            client.sendall(b"GET /scans HTTP/1.1\r\nHost: localhost\r\n\r\n")
        client.setblocking(False)
        return [client, 0]

    def is_open(self, slot):
        """Moves a client on. One that never reads only looks, without taking bytes."""
        client, sent = slot
        try:
            if self.is_slow:
                client.send(REQUEST[sent : sent + 1] or b"x")
                slot[1] += 1
                return client.recv(1) != b""
            # What arrived stays in the system's buffer, so that it gets full.
            client.recv(1, socket.MSG_PEEK)
            return client.send(b"") == 0 and not has_hung_up(client)
        except BlockingIOError:
            return True
        except OSError:
            return False

    def run(self):
        slots = [self.open() for _ in range(self.count)]
        while not self.is_over.wait(1):
            for place, slot in enumerate(slots):
                if slot and not self.is_open(slot):
                    slot[0].close()
                    slots[place] = self.open() if self.comes_back else None
        for client, _ in filter(None, slots):
            client.close()


def has_hung_up(client):
    """True if the server has closed the connection (TCP_INFO: not ESTABLISHED)."""
    return client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1) != b"\x01"


def measure(server, name, count, is_slow, comes_back=False):
    before = server.resident()
    server.viewer = "127.0.0.2" if comes_back else "127.0.0.1"
    attack = Attack(server, count, is_slow, comes_back)
    attack.start()
    health, scans, memory = [], [], []
    end = time.monotonic() + SPAN
    while time.monotonic() < end:
        time.sleep(1)
        health.append(timed(server.health))
        scans.append(timed(server.first_scan))
        memory.append(server.resident())
    attack.is_over.set()
    attack.join()
    time.sleep(5)
    print(
        f"{name}: resident {before:.1f} MiB before, at most {max(memory):.1f} during, "
        f"{server.resident():.1f} after; {len(health)} times /health {max(health) * 1000:.0f} ms "
        f"at most, first scan {max(scans) * 1000:.0f} ms at most; {attack.opened} connections"
    )
    return max(health) <= 2 and max(scans) <= 5


def main():
    server = Server(sys.argv[1])
    try:
        time.sleep(2)
        server.first_scan()
        is_good = measure(server, "300 byte by byte", 300, is_slow=True)
        is_good &= measure(server, "200 that never read", 200, is_slow=False)
        measure(server, "300 that come back", 300, is_slow=True, comes_back=True)
        measure(server, "200 that come back", 200, is_slow=False, comes_back=True)
    finally:
        server.process.terminate()
    sys.exit(not is_good)


main()
