"""Reads the example `interactive_wall` with a TUIO client that others wrote (PyPI: python-tuio).

    pip install python-tuio==0.0.9 python-osc==1.10.2
    python3 tests/examples/tuio.py target/debug/examples/interactive_wall
"""

import contextlib
import io
import queue
import socket
import subprocess
import sys
import threading
from statistics import median

from pythontuio import TuioClient, TuioListener

# Scans in which both hands must have been seen.
SCANS = 30
# The corners of the picture on the emulated wall, as the program prints them when they are touched.
CORNERS = ["0.381,0.574", "2.367,0.593", "2.367,-0.593", "0.382,-0.574"]
# In the emulated wall: the heights at which the hands move, and their speed in widths a second.
HEIGHTS = [0.25, 0.7]
SPEED = 0.25


class Listener(TuioListener):
    def __init__(self):
        self.events = queue.Queue()

    def add_tuio_cursor(self, cursor):
        self.events.put(("add", cursor.session_id, *cursor.position, 0))

    def update_tuio_cursor(self, cursor):
        self.events.put(("update", cursor.session_id, *cursor.position, cursor.velocity[0]))

    def remove_tuio_cursor(self, cursor):
        self.events.put(("remove", cursor.session_id, *cursor.position, 0))


with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
    probe.bind(("127.0.0.1", 0))
    address = probe.getsockname()
client, listener = TuioClient(address), Listener()
client.add_listener(listener)
program = subprocess.Popen([sys.argv[1], "emulated", f"{address[0]}:{address[1]}", *CORNERS])
try:
    # The client prints a line for each bundle.
    with contextlib.redirect_stdout(io.StringIO()):
        threading.Thread(target=client.start, daemon=True).start()
        hands, removed = {}, []
        while sum(len(hand) >= SCANS for hand in hands.values()) < len(HEIGHTS):
            kind, number, x, y, speed = listener.events.get(timeout=60)
            if kind == "add":
                assert number not in hands, f"{number} was added twice"
                hands[number] = []
            elif kind == "update":
                hands[number].append((x, y, speed))
            else:
                removed.append(number)
finally:
    program.kill()
    program.wait()

# The hands that have touched the corners are gone.
moving = sorted((hand for hand in hands.values() if len(hand) >= SCANS), key=lambda hand: hand[0][1])
assert len(moving) == len(hands) - len(removed), f"{len(hands)} cursors, {removed} left"
for hand, height in zip(moving, HEIGHTS, strict=True):
    assert all(0.09 < x < 0.91 and abs(y - height) < 0.02 for x, y, _ in hand), hand
    assert abs(median(abs(speed) for *_, speed in hand) - SPEED) < 0.02, hand
print(f"python-tuio saw {len(moving)} hands for {SCANS} scans or more")
