#!/usr/bin/env bash
# gpsd 3.22 (Debian 12) takes a sensor that echoes commands, as a laser scanner does, for a GPS.
#
# It sends questions of many makers, and looks at what comes back. Expected: nobody says anything about a place, so it
# finds no GPS. But one of its questions (`@F0.3=1*67`) passes for a sentence of NMEA when it is echoed. So gpsd tells its
# clients of a GPS, and that it has sent data. Debian's gpsd adds each adapter with a CP210x or a PL2303 as a device.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import os
import pty
import subprocess
import threading
import tty

from place import compare, connect, debian, free_port, run

debian("gpsd=3.22-4.1+deb12u1", "libgps28=3.22-4.1+deb12u1", "libbluetooth3=5.66-1+deb12u2",
       "libusb-1.0-0=2:1.0.26-1", "libdbus-1-3=1.14.10-1~deb12u1")
# To each line, which it has between braces.
answers = {"says nothing": b"", "refuses each line": b"E\n\n", "echoes each line, and refuses it": b"{}\nE\n\n"}


def device(answer):
    owner, program = pty.openpty()
    tty.setraw(program)
    with open(owner, "rb", buffering=0) as commands, open(os.dup(owner), "wb", buffering=0) as replies:
        names[answer] = os.ttyname(program)
        ready.release()
        rest = b""
        while part := commands.read(1000):
            *lines, rest = (rest + part.replace(b"\r\n", b"\n")).split(b"\n")
            for line in lines:
                replies.write(answer.replace(b"{}", line))


names, ready = {}, threading.Semaphore(0)
for answer in answers.values():
    threading.Thread(target=device, args=[answer], daemon=True).start()
    ready.acquire()
port = free_port()
run("gpsd", "-N", "-S", str(port), *names.values(), stderr=subprocess.DEVNULL)
client = connect(port)
client.sendall(b'?WATCH={"enable":true,"json":true};')
client.settimeout(15)
found = {}
try:
    for line in client.makefile():
        message = json.loads(line)
        if "driver" in message:
            found[message["path"]] = message["driver"]
except TimeoutError:
    # It has asked all its questions.
    pass
seen = {f"a device that {what}": found.get(names[answer]) for what, answer in answers.items()}
compare(seen, {
    "a device that says nothing": None,
    "a device that refuses each line": None,
    "a device that echoes each line, and refuses it": "NMEA0183",
})
END
