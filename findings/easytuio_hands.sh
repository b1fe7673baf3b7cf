#!/usr/bin/env bash
# easytuio 0.1.1 (PyPI) yields no cursor, and no error, from a frame of 20 cursors.
#
# A frame is one packet. This one has 1,344 bytes, and Ethernet carries 1,500. Expected: 20 cursors. It reads the first
# 1,024 bytes, and drops the error about the rest. If they end between two messages, it yields some: 15 of 18.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import io
import logging
import queue
import socket
import threading
import time

from place import compare, free_port, pypi

pypi("easytuio==0.1.1", "python-osc==1.10.2")
from easytuio import TUIOClient  # noqa: E402
from tuio_frames import packet  # noqa: E402

# python-osc warns of the end that is missing.
logging.disable()
cursors = queue.Queue()
address = ("127.0.0.1", free_port())
client = TUIOClient(*address)
client.register_callback("2Dcur", cursors.put)
sender = socket.socket(type=socket.SOCK_DGRAM)


def count(hands):
    """Counts the cursors of a frame: those before the one of the next frame."""
    end = 100 + hands
    sender.sendto(packet(1, {key: 0.5 for key in range(1, hands + 1)}), address)
    sender.sendto(packet(2, {end: 0.5}), address)
    keys = iter(lambda: cursors.get(timeout=30).session_id, end)
    return sum(0 < key <= hands for key in keys)


# It prints that it listens.
with contextlib.redirect_stdout(io.StringIO()):
    threading.Thread(target=client.start, daemon=True).start()
    while cursors.empty():
        sender.sendto(packet(0, {0: 0.5}), address)
        time.sleep(0.1)
    seen = {hands: count(hands) for hands in (14, 18, 20)}
compare(seen, {14: 14, 18: 15, 20: 0})
END
