# ser2net 4.3.11 (Debian 12) keeps a client whose power was cut for two hours, and refuses it meanwhile.
#
# Expected: the client, which starts again at its old address, gets the port within seconds. The system does probe the
# old connection, after two hours without a byte. A sensor that only answers sends none, so the port stays "already in
# use". With the option `kickolduser: true` the new connection takes it.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import pty
import re
import subprocess
import time
import tty

from place import PLACE, compare, ip, network, run, ser2net

CLIENT = """
import socket, sys, time
port = int(sys.argv[1])
for _ in range(200):
    try:
        server = socket.create_connection(("10.0.0.1", port), timeout=2)
        break
    except OSError:
        time.sleep(0.1)
try:
    print(server.recv(100).decode().strip(), flush=True)
except TimeoutError:
    print("connected", flush=True)
time.sleep(60)
"""


def start_host(port):
    """Starts a host with a client, as after power-up. Returns it, and what the client reads."""
    host = run("unshare", "--net", "sh", "-c", "read _; ip address add 10.0.0.2/24 dev client; "
               "ip link set client up; exec python3 -c \"$0\" \"$1\"", CLIENT, str(port),
               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    while os.readlink(f"/proc/{host.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
        time.sleep(0.01)
    ip("link", "add", "server", "type", "veth", "peer", "name", "client", "netns", str(host.pid))
    ip("link", "set", "server", "up")
    ip("route", "add", "10.0.0.2", "dev", "server")
    host.stdin.write("\n")
    host.stdin.flush()
    return host, host.stdout.readline().strip()


def cut_power(host):
    # No packet of its end gets out.
    ip("link", "set", "server", "down")
    host.kill()
    host.wait()
    while subprocess.run(["ip", "link", "delete", "server"], stderr=subprocess.DEVNULL).returncode == 0:
        pass


ser2net()
network()
configuration = PLACE / "ser2net.yaml"
connections = ""
for port, options in [(4001, ""), (4002, " options:\n  kickolduser: true\n")]:
    _owner, program = pty.openpty()
    tty.setraw(program)
    connections += (f"connection: &port{port}\n accepter: tcp,10.0.0.1,{port}\n"
                    f" connector: serialdev,{os.ttyname(program)},115200n81,local\n{options}")
configuration.write_text(f"%YAML 1.1\n---\n{connections}")
# It wants to announce itself, and complains that it cannot.
run("ser2net", "-n", "-c", configuration, stderr=subprocess.DEVNULL)
seen = {}
for port, what in [(4001, "by default"), (4002, "kickolduser")]:
    host, first = start_host(port)
    cut_power(host)
    host, second = start_host(port)
    sockets = subprocess.run(["ss", "--tcp", "--no-header", "--options", f"sport = :{port}"], check=True,
                             capture_output=True, text=True).stdout
    seen[what] = {"at first": first, "after the cut": second,
                  "minutes to the next probe": re.findall(r"keepalive,(\d+)min", sockets)}
    cut_power(host)
compare(seen, {
    "by default": {"at first": "connected", "after the cut": "Port already in use",
                   "minutes to the next probe": ["119"]},
    "kickolduser": {"at first": "connected", "after the cut": "connected",
                    "minutes to the next probe": ["119"]},
})
END
