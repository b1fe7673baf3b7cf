#!/usr/bin/env bash
# uam-05lp 0.2.0 (PyPI) takes a late reply for the answer to the next command, and is one reply behind from then on.
#
# It is for Hokuyo's safety scanner UAM-05LP, whose replies name their command. Expected after a TimeoutError: that the
# reply which comes later is dropped. It stays in the buffer. So each scan is the one before, with its OSSD outputs,
# however long ago that was, and a version is read from a scan, without an error.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import socket
import threading
import time

from place import compare, pypi

pypi("uam-05lp==0.2.0")
from uam_05lp import UAM05LP  # noqa: E402
from uam_05lp.exceptions import TimeoutError  # noqa: E402
from uam_scanner import answer  # noqa: E402

arrived = threading.Semaphore(0)


def send(client, reply, number):
    """Sends the first reply late."""
    if number == 1:
        time.sleep(1.5)
    client.sendall(reply)
    arrived.release()


def scan(sensor):
    """Which command the scan answers."""
    try:
        return sensor.get_distance().distances[540]
    except TimeoutError:
        return "timeout"
    finally:
        arrived.acquire(timeout=30)


with socket.create_server(("127.0.0.1", 0)) as listener, UAM05LP(*listener.getsockname()) as sensor:
    client, _ = listener.accept()
    talk = (client.recv, lambda reply, number: send(client, reply, number))
    threading.Thread(target=answer, args=talk, daemon=True).start()
    scans = [scan(sensor) for _ in range(4)]
    version = sensor.get_version().product_type
seen = {"scans of commands 1 to 4": scans, "version": version[:9]}
compare(seen, {"scans of commands 1 to 4": ["timeout", 1, 2, 3], "version": "000000000"})
END
