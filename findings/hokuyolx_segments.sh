#!/usr/bin/env bash
# hokuyolx 0.9.0 (PyPI) takes what one `recv` returns for one reply, and silently drops a scan.
#
# A UST-10LX acknowledges `MD` and then sends a scan at each revolution. Where both replies arrive
# together, as TCP permits, the first scan is gone: it is read as a part of the acknowledgement, without
# an error. Expected: 3 scans both times.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import socket
import threading
import time

from place import compare, pypi

pypi("hokuyolx==0.9.0", "numpy==2.2.6")
from hokuyolx import HokuyoLX  # noqa: E402

SCANS = 3


def with_sum(line):
    return line + chr((sum(line.encode()) & 0x3F) + 0x30) + "\n"


def reply(command, left):
    """The scan after which `left` are to come: 1,081 distances of 1,000 mm and more."""
    value = 1000 + SCANS - left
    data = "".join(chr((value >> bits & 63) + 0x30) for bits in (12, 6, 0)) * 1081
    lines = [with_sum(data[at : at + 64]) for at in range(0, len(data), 64)]
    return f"{command[:-2]}{left:02}\n99b\n" + with_sum("0001") + "".join(lines) + "\n"


def sense(listener, are_together):
    """A sensor for one client."""
    client, _ = listener.accept()
    for command in client.makefile(newline="\n"):
        pending = f"{command}00P\n\n"
        if command.startswith("MD"):
            for left in reversed(range(SCANS)):
                if not are_together:
                    client.sendall(pending.encode())
                    time.sleep(0.5)
                    pending = ""
                client.sendall((pending + reply(command.rstrip(), left)).encode())
                pending = ""
                are_together = True
                time.sleep(0.5)
        else:
            client.sendall(pending.encode())


def distances(are_together):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        arguments = (listener, are_together)
        threading.Thread(target=sense, args=arguments, daemon=True).start()
        # Nothing but the scans.
        own = {"activate": False, "info": False, "tsync": False, "convert_time": False}
        sensor = HokuyoLX(addr=listener.getsockname(), **own)
        return [int(scan[0]) for scan, _, _ in sensor.iter_dist(SCANS)]


seen = {"apart": distances(False), "together": distances(True)}
compare(seen, {"apart": [1001, 1002, 1003], "together": [1002, 1003]})
END
