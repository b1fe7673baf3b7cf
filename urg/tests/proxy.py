"""Compares scans behind nginx, and Caddy if it is there, with scans that come directly.

    apt-get install nginx-light
    python3 urg/tests/proxy.py target/debug/urg

Runs nginx with its defaults, and each proxy with the lines of `guide/operating.md`. A scan may
come 20 ms later than to another direct reader, which a busy machine delays as much.
"""

import contextlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from http.client import HTTPConnection
from pathlib import Path

LIMIT = 0.020
CONTROL = "direct again"
SCANS = 50
GUIDE = (Path(__file__).parent.parent / "guide/operating.md").read_text()
# What the guide calls the server of `urg`, and the proxy.
SERVER, NAME = "127.0.0.1:8080", "urg.example"
NGINX = """daemon off; pid {place}/pid; error_log {place}/errors;
events {{}}
http {{ access_log off; gzip on; {temporary}
{servers} }}"""
TEMPORARY = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"]


def guide(language):
    return re.search(rf"```{language}\n(.*?)```", GUIDE, re.DOTALL)[1]


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@contextlib.contextmanager
def running(*command, **options):
    process = subprocess.Popen(command, **options)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


@contextlib.contextmanager
def serving(program, *arguments):
    command = [program, "serve", *arguments, "--host", NAME, "--listen", "0"]
    with running(*command, stderr=subprocess.PIPE, text=True) as server:
        for line in server.stderr:
            if found := re.search(r"http://(127\.0\.0\.1:\d+)/", line):
                break
        # Nobody reads the rest, which is short.
        yield found[1]


@contextlib.contextmanager
def behind(server, place):
    """Runs the proxies. Yields the address of each."""
    ports = {name: free_port() for name in ("nginx", "nginx as in the guide")}
    defaults = f"location / {{ proxy_pass http://{server}; }}"
    lines = [defaults, guide("nginx").replace(SERVER, server)]
    servers = [
        f"server {{ listen 127.0.0.1:{port}; {line} }}" for port, line in zip(ports.values(), lines)
    ]
    temporary = [f"{name}_temp_path {place}/{name};" for name in TEMPORARY]
    configuration = place / "nginx.conf"
    configuration.write_text(
        NGINX.format(place=place, temporary=" ".join(temporary), servers="\n".join(servers))
    )
    with contextlib.ExitStack() as stack:
        command = ["nginx", "-p", place, "-e", place / "errors", "-c", configuration]
        stack.enter_context(running(*command))
        if shutil.which("caddy"):
            port = ports["caddy as in the guide"] = free_port()
            lines = guide("caddy").replace(NAME, f"http://{NAME}:{port}").replace(SERVER, server)
            configuration = place / "Caddyfile"
            configuration.write_text("{\n admin off\n}\n" + lines)
            command = ["caddy", "run", "--config", configuration, "--adapter", "caddyfile"]
            stack.enter_context(running(*command, stderr=subprocess.DEVNULL))
        for port in ports.values():
            wait_for(port)
        yield {name: f"127.0.0.1:{port}" for name, port in ports.items()}


def wait_for(port):
    for _ in range(100):
        with contextlib.suppress(OSError):
            return socket.create_connection(("127.0.0.1", port)).close()
        time.sleep(0.1)
    raise TimeoutError(f"nobody listens on {port}")


def read(address, host, accept, arrivals):
    connection = HTTPConnection(address, timeout=30)
    connection.request("GET", f"/scans?max={SCANS}", headers={"Host": host, "Accept": accept})
    for line in connection.getresponse():
        if found := re.search(rb'"sequence":(\d+)', line):
            arrivals[int(found[1])] = time.monotonic()


def measure(program, arguments, accept):
    """Returns the latenesses behind each proxy, sorted."""
    with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
        server = stack.enter_context(serving(program, *arguments))
        places = {"direct": server, CONTROL: server} | stack.enter_context(behind(server, Path(place)))
        arrivals = {name: {} for name in places}
        readers = [
            threading.Thread(target=read, args=(address, host(name, address), accept, arrivals[name]))
            for name, address in places.items()
        ]
        [reader.start() for reader in readers]
        [reader.join() for reader in readers]
    direct = arrivals.pop("direct")
    return {
        name: sorted(at - direct[number] for number, at in later.items() if number in direct)
        for name, later in arrivals.items()
    }


def host(name, address):
    return address if "direct" in name else f"{NAME}:{address.split(':')[1]}"


def check_lateness(program, arguments, accept):
    # In real time: a busy machine delays what it likes. A buffer delays scans each time.
    for attempt in range(3):
        measured = measure(program, arguments, accept)
        parts = {
            name: [late[len(late) * part // 100] for part in (50, 95)]
            for name, late in measured.items()
        }
        for name, (median, most) in parts.items():
            print(f"{' '.join(arguments)}, {accept}, {name}: {len(measured[name])} scans later by "
                  f"{1000 * median:.1f} ms (median), {1000 * most:.1f} (95 %)")
        control = parts.pop(CONTROL)
        if all(len(late) > SCANS * 9 // 10 for late in measured.values()) and all(
            found < direct + LIMIT for part in parts.values() for found, direct in zip(part, control)
        ):
            return
    sys.exit(f"scans come more than {1000 * LIMIT:.0f} ms later than directly")


def check_controls(program):
    """Checks that the page can control a recording behind the guide's proxies."""
    with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
        recording = f"{place}/run.mcap"
        subprocess.run([program, "record", "emulated", recording, "--count", "5"], check=True,
                       stderr=subprocess.DEVNULL)
        server = stack.enter_context(serving(program, recording))
        for name, address in stack.enter_context(behind(server, Path(place))).items():
            own = host(name, address)
            connection = HTTPConnection(address, timeout=30)
            connection.request("POST", "/playback?pause",
                               headers={"Host": own, "Origin": f"http://{own}"})
            status = connection.getresponse().status
            assert status == (204 if "guide" in name else 403), f"{name}: status {status}"


program = sys.argv[1]
for arguments in (["emulated"], ["emulated", "--from", "-5deg", "--to", "5deg"]):
    for accept in ("text/event-stream", "application/x-ndjson"):
        check_lateness(program, arguments, accept)
check_controls(program)
if not shutil.which("caddy"):
    print("skipped: Caddy")
