#!/usr/bin/env bash
# pyserial 3.5's `rfc2217://` cannot open a port of ser2net 4.3.11 (Debian 12) whose device is a pseudo-terminal.
#
# Both speak the protocol, and the same port opens as a raw one. Expected: it opens, without modem lines. But pyserial
# demands an answer to its setting of DTR and RTS, which ser2net does not give for a terminal that has none: no test
# of RFC 2217 with these two runs without a real serial port.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import pty
import subprocess
import tty

from place import PLACE, compare, connect, free_port, pypi, run, ser2net

pypi("pyserial==3.5")
import serial  # noqa: E402

_owner, program = pty.openpty()
tty.setraw(program)
ser2net()
ports = {"socket": ("tcp", free_port()), "rfc2217": ("telnet(rfc2217),tcp", free_port())}
configuration = PLACE / "ser2net.yaml"
configuration.write_text("%YAML 1.1\n---\n" + "".join(
    f"connection: &{name}\n accepter: {accepter},127.0.0.1,{port}\n"
    f" connector: serialdev,{os.ttyname(program)},115200n81,local\n options:\n  kickolduser: true\n"
    for name, (accepter, port) in ports.items()
))
# It wants to announce itself, and complains that it cannot.
run("ser2net", "-n", "-c", configuration, stderr=subprocess.DEVNULL)


def opens(name):
    port = ports[name][1]
    connect(port).close()
    try:
        serial.serial_for_url(f"{name}://127.0.0.1:{port}", baudrate=115200).close()
        return "opened"
    except serial.SerialException as error:
        return str(error)


seen = {name: opens(name) for name in ports}
compare(seen, {"socket": "opened", "rfc2217": "timeout while waiting for option 'control'"})
END
