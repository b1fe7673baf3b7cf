#!/usr/bin/env bash
# Two TUIO clients, tuio-client 0.1.0 (npm) and python-tuio 0.0.9 (PyPI), mix up two trackers on one port.
#
# TUIO 1.1 names the source of each frame, so that several trackers can send to one client: two scanners beside
# one wall. Expected: the cursors of both. Both clients ignore the name, so each frame removes the other tracker's
# cursor. If the trackers' frames have numbers less than 100 apart, tuio-client takes those of one for late, and
# drops them.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import io
import queue
import socket
import threading
import time

from place import compare, free_port, pypi

pypi("python-tuio==0.0.9", "python-osc==1.10.2")
import tuio_client  # noqa: E402
from pythontuio import TuioClient, TuioListener  # noqa: E402
from tuio_frames import messages, packet  # noqa: E402

# Session id of a cursor that ends the events.
END = 99


def frames(ahead):
    """Frames of two trackers by turns, each with a cursor that rests."""
    for number in range(1, 4):
        yield number, {1: 0.25}, "left@127.0.0.1"
        yield number + ahead, {2: 0.75}, "right@127.0.0.1"


class Listener(TuioListener):
    def __init__(self):
        self.events, self.is_ready = queue.Queue(), False

    def add_tuio_cursor(self, cursor):
        self.events.put(("add", cursor.session_id, cursor.position[0]))

    def update_tuio_cursor(self, cursor):
        self.events.put(("update", cursor.session_id, cursor.position[0]))

    def remove_tuio_cursor(self, cursor):
        self.events.put(("remove", cursor.session_id, cursor.position[0]))

    def refresh(self, time):
        self.is_ready = True


def by_python():
    address = ("127.0.0.1", free_port())
    client, listener = TuioClient(address), Listener()
    client.add_listener(listener)
    # It prints a line for each frame.
    with contextlib.redirect_stdout(io.StringIO()), socket.socket(type=socket.SOCK_DGRAM) as sender:
        threading.Thread(target=client.start, daemon=True).start()
        # Without cursors, until the client listens.
        while not listener.is_ready:
            sender.sendto(packet(0, {}), address)
            time.sleep(0.1)
        for frame in [*frames(0), (0, {END: 0.5})]:
            sender.sendto(packet(*frame), address)
        return list(iter(lambda: listener.events.get(timeout=30), ("add", END, 0.5)))


seen = {
    "python-tuio": by_python(),
    "tuio-client": tuio_client.events([messages(*frame) for frame in frames(0)]),
    "tuio-client, the right one ahead by 50": tuio_client.events([messages(*frame) for frame in frames(50)]),
}
left, right = (1, 0.25), (2, 0.75)
compare(seen, {
    # It tells of new cursors first.
    "python-tuio": [
        ("add", *left),
        *[("add", *right), ("remove", *left), ("add", *left), ("remove", *right)] * 2,
        ("add", *right), ("remove", *left),
    ],
    "tuio-client": [
        ("add", *left),
        *[("remove", *left), ("add", *right), ("remove", *right), ("add", *left)] * 2,
        ("remove", *left), ("add", *right),
    ],
    "tuio-client, the right one ahead by 50": [
        ("add", *left), ("remove", *left), ("add", *right), ("update", *right), ("update", *right),
    ],
})
END
