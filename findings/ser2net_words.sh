#!/usr/bin/env bash
# ser2net 4.3.11 (Debian 12) explains itself in plain text on a raw connection.
#
# Expected: a raw TCP port carries nothing but the bytes of the device, and is closed or refused where there
# is none. A second client, and one whose device is away, read a line of English first, which a program takes for
# bytes of the device.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import pty
import subprocess
import tty

from place import PLACE, compare, connect, free_port, run, ser2net

_owner, program = pty.openpty()
tty.setraw(program)
ser2net()
there, away = free_port(), free_port()
devices = {there: os.ttyname(program), away: PLACE / "away"}
configuration = PLACE / "ser2net.yaml"
configuration.write_text("%YAML 1.1\n---\n" + "".join(
    f"connection: &port{port}\n accepter: tcp,127.0.0.1,{port}\n connector: serialdev,{device},115200n81,local\n"
    for port, device in devices.items()
))
# It wants to announce itself, and complains that it cannot.
run("ser2net", "-n", "-c", configuration, stderr=subprocess.DEVNULL)


def reads(port):
    client = connect(port)
    text = b""
    while part := client.recv(100):
        text += part
    return text.decode()


first = connect(there)
seen = {"a second client": reads(there), "the device is away": reads(away)}
compare(seen, {
    "a second client": "Port already in use\r\n",
    "the device is away": "Device open failure: Value or file not found\r\n",
})
END
