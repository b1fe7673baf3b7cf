#!/usr/bin/env bash
# Two kinds of exclusive: pyserial's `exclusive=True` (flock) and a terminal's TIOCEXCL do not know of each other.
#
# Expected: a port that one program holds exclusively cannot be held exclusively by another. pyserial 3.5
# takes a lock on the file. Programs in C, and Rust's serialport, mark the terminal. So both hold it. The mark
# also stays when the program that made it has closed the port, as long as any other has it open.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import fcntl
import os
import platform
import pty
import struct
import termios
import tty

from place import compare, pypi

pypi("pyserial==3.5")
import serial  # noqa: E402

TIOCGEXCL = 0x80045440


def is_marked(file):
    return bool(struct.unpack("i", fcntl.ioctl(file, TIOCGEXCL, bytes(4)))[0])


_owner, program = pty.openpty()
tty.setraw(program)
name = os.ttyname(program)
port = serial.Serial(name, exclusive=True)
by_pyserial = is_marked(program)
other = os.open(name, os.O_RDWR | os.O_NOCTTY)
fcntl.ioctl(other, termios.TIOCEXCL)
by_another = is_marked(program)
os.close(other)
print(f"Linux {platform.release()}, pyserial {serial.__version__}")
seen = {
    "marked by pyserial": by_pyserial,
    "marked by another program": by_another,
    "still marked after it closed": is_marked(program),
    "pyserial reads": port.in_waiting == 0,
}
compare(seen, {
    "marked by pyserial": False,
    "marked by another program": True,
    "still marked after it closed": True,
    "pyserial reads": True,
})
END
