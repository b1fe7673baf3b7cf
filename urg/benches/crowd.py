#!/usr/bin/env python3
"""Measures `urg serve` under all kinds of clients at once.

    cargo build --release -p urg
    python3 benches/crowd.py target/release/urg [SECONDS]

For ten minutes: 1,000 idle connections, 100 viewers from 20 addresses, 50 viewers that
read ten bytes a second, and 200 clients that send a request byte by byte. A client that
the server closes or refuses comes back, the idle ones after 10 s and others after 5 s.
The sensor is emulated by another process.

Prints a row each minute: the polls and scans a second (/metrics), the longest /health,
asked every second from an address of its own, what the viewers got, and the memory of
the server (/proc: Linux). Ends with 1 if /health takes more than 2 s, or polls or scans
differ from 10 a second by more than 1 %.
"""

import asyncio
import re
import resource
import socket
import subprocess
import sys
import tempfile
import time

SPAN = float(sys.argv[2]) if len(sys.argv) > 2 else 600.0
ROW = 60
RATE = 10.0
REQUEST = b"GET /scans HTTP/1.1\r\nHost: localhost\r\n\r\n"
HALF = REQUEST[:-4] + b"\r\nX-Slow: " + b"x" * 1000


class Server:
    """`urg serve` with an emulated sensor in another process."""

    def __init__(self, program, folder):
        link = f"{folder}/urg"
        self.sensor = subprocess.Popen(
            [program, "emulate", "--link", link], stderr=subprocess.PIPE, text=True
        )
        self.sensor.stderr.readline()
        self.process = subprocess.Popen(
            [program, "serve", link, "--listen", "0"], stderr=subprocess.PIPE, text=True
        )
        self.port = int(re.search(r"127\.0\.0\.1:(\d+)", self.process.stderr.readline())[1])

    async def connect(self, address):
        client = socket.socket()
        client.setblocking(False)
        client.bind((address, 0))
        loop = asyncio.get_running_loop()
        try:
            await loop.sock_connect(client, ("127.0.0.1", self.port))
        except BaseException:
            client.close()
            raise
        return client

    async def get(self, path):
        loop, body = asyncio.get_running_loop(), b""
        client = await self.connect("127.0.0.2")
        await loop.sock_sendall(client, b"GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n" % path)
        while piece := await loop.sock_recv(client, 65536):
            body += piece
        client.close()
        return body

    async def health(self):
        began = time.monotonic()
        body = await self.get(b"/health")
        assert body.startswith(b"HTTP/1.1 200"), body
        return time.monotonic() - began

    async def polls_and_scans(self):
        body = (await self.get(b"/metrics")).decode()
        figures = (rf"urg_{name}_total (\d+)" for name in ("polls", "scans"))
        return time.monotonic(), *(int(re.search(figure, body)[1]) for figure in figures)

    def memory(self):
        with open(f"/proc/{self.process.pid}/status") as status:
            text = status.read()
        figure = lambda name: int(re.search(rf"{name}:\s+(\d+) kB", text)[1]) / 1024
        return figure("VmRSS"), figure("VmHWM")

    def stop(self):
        for process in (self.process, self.sensor):
            process.terminate()
            process.wait()


class Counts:
    opened = refused = closed = scans = 0
    longest_gap = 0.0
    seated = 0


async def come_back(server, address, pause, use, counts):
    """Connects, uses the connection, and again when it is closed."""
    while True:
        try:
            client = await server.connect(address)
            counts.opened += 1
            try:
                await use(client)
            finally:
                client.close()
        except OSError:
            pass
        await asyncio.sleep(pause)


async def stay_idle(client):
    await asyncio.get_running_loop().sock_recv(client, 1)


async def send_slowly(client):
    for byte in HALF:
        await asyncio.get_running_loop().sock_sendall(client, bytes([byte]))
        await asyncio.sleep(1)


async def read_slowly(client):
    loop = asyncio.get_running_loop()
    await loop.sock_sendall(client, REQUEST)
    while await loop.sock_recv(client, 10):
        await asyncio.sleep(1)


async def view(client, counts):
    loop = asyncio.get_running_loop()
    await loop.sock_sendall(client, REQUEST)
    head = await loop.sock_recv(client, 65536)
    if b" 200 " not in head[:16]:
        counts.refused += 1
        return
    counts.seated += 1
    last, end = time.monotonic(), b""
    try:
        while piece := await loop.sock_recv(client, 65536):
            # A word that two pieces share is found with the second one.
            found = (end + piece).count(b'"sequence":') - end.count(b'"sequence":')
            end = piece[-10:]
            if found:
                counts.scans += found
                now = time.monotonic()
                counts.longest_gap, last = max(counts.longest_gap, now - last), now
        counts.closed += 1
    finally:
        counts.seated -= 1


async def crowd(server):
    counts, others = Counts(), Counts()
    viewing = lambda client: view(client, counts)
    clients = [("127.0.0.1", 10, stay_idle, others)] * 1000
    clients += [(f"127.0.1.{1 + n % 20}", 5, viewing, counts) for n in range(100)]
    clients += [(f"127.0.2.{1 + n % 10}", 5, read_slowly, others) for n in range(50)]
    clients += [(f"127.0.3.{1 + n % 10}", 5, send_slowly, others) for n in range(200)]
    tasks = [
        asyncio.create_task(come_back(server, address, pause, use, counted))
        for address, pause, use, counted in clients
    ]
    print("time   polls/s  scans/s  /health at most  viewers: seated  scans  longest gap  refused  "
          "closed  other connections  memory  peak")
    first = before = await server.polls_and_scans()
    seated_scans, slowest, worst = 0, 0.0, 0.0
    start = next_second = time.monotonic()
    next_row = start + ROW
    while next_second < start + SPAN:
        next_second += 1
        await asyncio.sleep(next_second - time.monotonic())
        slowest = max(slowest, await server.health())
        if time.monotonic() >= next_row:
            next_row += ROW
            after = await server.polls_and_scans()
            span = after[0] - before[0]
            polls, scans = ((b - a) / span for a, b in zip(before[1:], after[1:]))
            resident, peak = server.memory()
            print(f"{after[0] - start:4.0f} s  {polls:7.2f}  {scans:7.2f}  {slowest * 1000:12.0f} ms"
                  f"  {counts.seated:15}  {(counts.scans - seated_scans) / span:5.0f}/s"
                  f"  {counts.longest_gap * 1000:7.0f} ms  {counts.refused:7}  {counts.closed:6}"
                  f"  {others.opened:17}  {resident:.1f} MiB  {peak:.1f}", flush=True)
            before, seated_scans = after, counts.scans
            worst, slowest, counts.longest_gap = max(worst, slowest), 0.0, 0.0
    worst = max(worst, slowest)
    last = await server.polls_and_scans()
    span = last[0] - first[0]
    polls, scans = ((b - a) / span for a, b in zip(first[1:], last[1:]))
    print(f"in all {span:.0f} s: {polls:.3f} polls and {scans:.3f} scans a second, /health "
          f"{worst * 1000:.0f} ms at most, peak {server.memory()[1]:.1f} MiB")
    for task in tasks:
        task.cancel()
    return worst <= 2 and all(abs(rate / RATE - 1) <= 0.01 for rate in (polls, scans))


def main():
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    with tempfile.TemporaryDirectory() as folder:
        server = Server(sys.argv[1], folder)
        try:
            is_good = asyncio.run(crowd(server))
        finally:
            server.stop()
    sys.exit(not is_good)


main()
