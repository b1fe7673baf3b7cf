#!/usr/bin/env bash
# uam-05lp 0.2.0 (PyPI) waits for each reply over USB as long as the timeout, although the reply came at once.
#
# It is for Hokuyo's safety scanner UAM-05LP; here a pseudo-terminal is its port. Expected: the milliseconds that a
# reply takes over TCP, and the timeout only if none comes. But it asks pyserial for 4,096 bytes, which waits until it
# has them. A version is shorter, and so is the rest of a scan, of 4,379: a scan a second, with a longer timeout fewer.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import pty
import socket
import threading
import time
import tty

from place import compare, pypi

pypi("uam-05lp==0.2.0", "pyserial==3.5")
from uam_05lp import UAM05LP, SerialTransport  # noqa: E402
from uam_scanner import answer  # noqa: E402


def seconds(sensor):
    """Whole seconds that a version and a scan take."""
    with sensor:
        before = time.monotonic()
        assert sensor.get_version().product_type == "UAM-05LP"
        between = time.monotonic()
        assert len(sensor.get_distance().distances) == 1081
        return int(between - before), int(time.monotonic() - between)


def over_usb(timeout):
    owner, program = pty.openpty()
    tty.setraw(program)
    talk = (lambda size: os.read(owner, size), lambda reply, _: os.write(owner, reply))
    threading.Thread(target=answer, args=talk, daemon=True).start()
    transport = SerialTransport(os.ttyname(program))
    return seconds(UAM05LP(transport=transport, timeout_s=timeout))


def over_tcp(timeout):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        sensor = UAM05LP(*listener.getsockname(), timeout_s=timeout)
        sensor.open()
        client, _ = listener.accept()
        talk = (client.recv, lambda reply, _: client.sendall(reply))
        threading.Thread(target=answer, args=talk, daemon=True).start()
        return seconds(sensor)


seen = {"TCP": over_tcp(3), "USB, 1 s": over_usb(1), "USB, 3 s": over_usb(3)}
compare(seen, {"TCP": (0, 0), "USB, 1 s": (1, 1), "USB, 3 s": (3, 3)})
END
