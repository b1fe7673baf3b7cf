#!/usr/bin/env bash
# hokuyolx 0.9.0 (PyPI) ends its own stream once the clocks of sensor and computer are 0.3 s apart.
#
# A UST-10LX has a clock of its own. If it drifts by 0.01 %, they are 0.3 s apart after 50 minutes, and at once if the
# computer's clock is set. Expected: further scans with mended times, as it logs "Resyncing". But for that it stops the
# scans, and reads the sensor's clock for a second. Then it compares the new time with the scan that it already had,
# which is by now a second old, and so more than 0.3 s: it begins again, without end. `convert_time=False` avoids it.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import logging
import select
import socket
import threading
import time

from place import compare, pypi

pypi("hokuyolx==0.9.0", "numpy==2.2.6")
from hokuyolx import HokuyoLX  # noqa: E402

SCANS = 6
logging.getLogger("hokuyo").setLevel(logging.ERROR)


def with_sum(line):
    return line + chr((sum(line.encode()) & 0x3F) + 0x30) + "\n"


def characters(value, count):
    return "".join(chr((value >> 6 * digit & 63) + 0x30) for digit in reversed(range(count)))


def sense(listener, behind, commands):
    """A sensor for one client. From its third scan on, its clock is `behind` milliseconds behind."""
    client, _ = listener.accept()
    begin = time.monotonic()
    streaming, pending, late = None, 0, 0
    while True:
        ready, _, _ = select.select([client], [], [], 0.1)
        clock = round((time.monotonic() - begin) * 1000) + 100_000
        if not ready and streaming and pending:
            pending -= 1
            late = behind if pending <= SCANS - 3 else 0
            scan = with_sum(characters(clock - late, 4)) + with_sum(characters(1000, 3) * 3)
            client.sendall(f"{streaming[:-2]}{pending:02}\n99b\n{scan}\n".encode())
        if not ready:
            continue
        command = client.recv(100).decode().strip()
        if not command:
            return
        commands.append(command[:2])
        reply = "00P\n"
        if command == "%ST":
            reply += with_sum("004" if streaming else "000")
        elif command == "TM1":
            reply += with_sum(characters(clock - late, 4))
        elif command == "QT":
            streaming = None
        elif command.startswith("MD"):
            streaming, pending = command, SCANS
        client.sendall(f"{command}\n{reply}\n".encode())


def run(behind):
    """What happens within seven seconds, of which two are enough for the scans."""
    listener = socket.create_server(("127.0.0.1", 0))
    commands, scans = [], []
    threading.Thread(target=sense, args=(listener, behind, commands), daemon=True).start()

    def read():
        sensor = HokuyoLX(addr=listener.getsockname(), activate=False, info=False)
        commands.clear()
        for scan in sensor.iter_dist(SCANS, 0, 2):
            scans.append(scan)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(7)
    # 12 commands read the clock once.
    again = "reads the clock again and again" if commands.count("TM") > 24 else "reads no clock"
    return f"{len(scans)} scans", "stops the sensor" if "QT" in commands else "does not stop it", again


seen = {"0.25 s behind": run(250), "0.35 s behind": run(350)}
compare(seen, {
    "0.25 s behind": ("6 scans", "does not stop it", "reads no clock"),
    "0.35 s behind": ("2 scans", "stops the sensor", "reads the clock again and again"),
})
END
