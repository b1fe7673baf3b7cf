#!/usr/bin/env bash
# Linux: a pseudo-terminal says that all output is sent while nobody has read a byte of it.
#
# Expected of 1,000 bytes that the other side has not read: `out_waiting` (TIOCOUTQ) is 1,000, `flush`
# (tcdrain) waits, and `reset_output_buffer` (tcflush) drops them, as on a serial port. They are 0, no wait,
# and no effect. So no test on a pseudo-terminal shows how a program treats output that is stuck.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import platform
import pty
import threading
import tty

from place import compare, pypi

pypi("pyserial==3.5")
import serial  # noqa: E402

owner, program = pty.openpty()
tty.setraw(program)
port = serial.Serial(os.ttyname(program))
port.write(b"x" * 1000)
waiting = port.out_waiting
flush = threading.Thread(target=port.flush, daemon=True)
flush.start()
flush.join(5)
port.reset_output_buffer()
print(f"Linux {platform.release()}, pyserial {serial.__version__}")
seen = {
    "bytes to be sent": waiting,
    "flush waits": flush.is_alive(),
    "bytes after they were dropped": len(os.read(owner, 4096)),
}
compare(seen, {"bytes to be sent": 0, "flush waits": False, "bytes after they were dropped": 1000})
END
