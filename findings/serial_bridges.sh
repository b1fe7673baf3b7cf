#!/usr/bin/env bash
# serial-tcp-clients 2.6.0 and serial2tcp 0.5.3 (PyPI): a client waits for ever after its device was unplugged.
#
# A pseudo-terminal is the device, and comes back under its old name. Expected: the connection of the client ends,
# and a new one reaches the device, as with ser2tcp 3.2.0. The first leaves the connection open and silent, and
# opens the device again only for a client that connects anew. The second ends the connection only when the client
# writes. It never opens the device again, so new clients get nothing until it is restarted.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import os
import pty
import subprocess
import time
import tty

from place import PLACE, compare, connect, free_port, pypi, run

programs = pypi("ser2tcp==3.2.0", "serial-tcp-clients==2.6.0", "serial2tcp==0.5.3") / "bin"
os.environ["PYTHONPATH"] = str(PLACE / "pypi")
device = PLACE / "device"


def plug_in():
    owner, program = pty.openpty()
    tty.setraw(program)
    device.unlink(missing_ok=True)
    device.symlink_to(os.ttyname(program))
    return owner, program


def receives(client):
    client.settimeout(3)
    try:
        return client.recv(100).decode() or "the end"
    except TimeoutError:
        return "nothing"
    except ConnectionError:
        return "the end"


def clients(*command):
    owner, program = plug_in()
    run(*command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    first = connect(port)
    time.sleep(2)
    os.write(owner, b"before\n")
    seen = [receives(first)]
    os.close(owner)
    os.close(program)
    seen.append(receives(first))
    # Now each bridge must notice it.
    try:
        first.sendall(b"?\n")
    except ConnectionError:
        pass
    owner, program = plug_in()
    time.sleep(6)
    os.write(owner, b"back\n")
    seen.append(receives(first))
    second = connect(port)
    time.sleep(2)
    os.write(owner, b"new\n")
    return [*seen, "a new client is served" if receives(second) == "new\n" else "none is"]


port = free_port()
configuration = PLACE / "ser2tcp.json"
server = {"address": "127.0.0.1", "port": port, "protocol": "tcp"}
configuration.write_text(json.dumps({"ports": [{"serial": {"port": str(device)}, "servers": [server]}]}))
seen = {"ser2tcp": clients(programs / "ser2tcp", "-c", configuration)}
port = free_port()
splitter = [programs / "serial-tcp-server", "-p", str(port), "-d", device]
seen["serial-tcp-clients"] = clients(*splitter)
port = free_port()
redirector = [programs / "serial2tcp", "-P", str(port), "-p", device, "--access-list=127.0.0.1"]
seen["serial2tcp"] = clients(*redirector)
# The client with the device, without it, and when it is back; then a new one.
compare(seen, {
    "ser2tcp": ["before\n", "the end", "the end", "a new client is served"],
    "serial-tcp-clients": ["before\n", "nothing", "nothing", "a new client is served"],
    "serial2tcp": ["before\n", "nothing", "the end", "none is"],
})
END
