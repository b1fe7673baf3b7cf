#!/usr/bin/env bash
# Linux: a pseudo-terminal's program loses what it has not read when the other side closes.
#
# Expected: as with a pipe or a socket, what was written before the close can be read, and then the end.
# That holds in one direction alone: the owner of the terminal reads it, the program on it reads nothing.
# An emulated device, or socat, that answers and exits takes its last answer with it.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import platform
import pty
import time
import tty

from place import compare, pypi

pypi("pyserial==3.5")
import serial  # noqa: E402


def program_reads():
    owner, program = pty.openpty()
    tty.setraw(program)
    port = serial.Serial(os.ttyname(program), timeout=1)
    os.write(owner, b"last")
    while port.in_waiting < 4:
        time.sleep(0.01)
    os.close(owner)
    try:
        return port.read(4)
    except serial.SerialException as error:
        return str(error)


def owner_reads():
    owner, program = pty.openpty()
    tty.setraw(program)
    with serial.Serial(os.ttyname(program)) as port:
        port.write(b"last")
    os.close(program)
    return os.read(owner, 4)


print(f"Linux {platform.release()}, pyserial {serial.__version__}")
seen = {"the owner reads": owner_reads(), "the program reads": program_reads()}
lost = "device reports readiness to read but returned no data (device disconnected or multiple access on port?)"
compare(seen, {"the owner reads": b"last", "the program reads": lost})
END
