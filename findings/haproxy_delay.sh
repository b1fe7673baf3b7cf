#!/usr/bin/env bash
# HAProxy 2.6.12 (Debian 12) holds each server-sent event for 0.2 s, and with `compression` most until the next one.
#
# Expected: an event passes at once, as through Apache, h2o and Varnish of Debian 12. It tells the system that more bytes
# follow, which waits for them up to 0.2 s, unless `option http-no-delay` is set. Its gzip keeps the last bits of an
# event until further ones come, with that option, too, unless they fill a byte: the last event before a pause arrives
# after it. It does not compress an answer with `Cache-Control: no-transform`.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import http.client
import socket
import threading
import time
import zlib

from place import PLACE, compare, connect, debian, free_port, run

EVENTS, PERIOD = 4, 1.0
EVENT = b"data: " + b",".join(b"%d" % (1000 + 37 * number % 997) for number in range(300)) + b"\n\n"
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"


def send(client, sent):
    """Sends the events, and then the end of the answer."""
    with contextlib.suppress(OSError), client:
        if not client.recv(10_000):
            return
        client.sendall(HEAD)
        for _ in range(EVENTS):
            time.sleep(PERIOD)
            sent.append(time.monotonic())
            client.sendall(b"%x\r\n%b\r\n" % (len(EVENT), EVENT))
        time.sleep(PERIOD)
        client.sendall(b"0\r\n\r\n")


def serve(listener, sent):
    while True:
        client, _ = listener.accept()
        threading.Thread(target=send, args=[client, sent], daemon=True).start()


def delays(lines):
    """Returns how late each event arrives if these lines are among the defaults."""
    sent, port = [], free_port()
    listener = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=serve, args=[listener, sent], daemon=True).start()
    file = PLACE / f"haproxy{port}.cfg"
    file.write_text("\n ".join([
        "defaults", "mode http", "timeout connect 5s", "timeout client 60s", "timeout server 60s", *lines,
    ]) + f"\nlisten scans\n bind 127.0.0.1:{port}\n server urg 127.0.0.1:{listener.getsockname()[1]}\n")
    run(root / "usr/sbin/haproxy", "-db", "-f", file)
    connect(port).close()
    client = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    client.request("GET", "/", headers={"Accept-Encoding": "gzip"})
    answer = client.getresponse()
    inflate = zlib.decompressobj(31).decompress if answer.getheader("Content-Encoding") == "gzip" else bytes
    late, text = [], b""
    while part := answer.read1(65536):
        text += inflate(part)
        while len(late) < text.count(b"\n\n"):
            seconds = time.monotonic() - sent[len(late)]
            late.append("at once" if seconds < 0.1 else "0.2 s" if seconds < 0.8 * PERIOD else "with the next")
    return late


root = debian("haproxy=2.6.12-1+deb12u4", "liblua5.3-0=5.3.6-2", "libopentracing1=1.6.0-4",
              "libopentracing-c-wrapper0=1.1.3-3+b1")
PROMPT, GZIP = "option http-no-delay", "compression algo gzip"
seen = {"defaults": delays([]), PROMPT: delays([PROMPT]), GZIP: delays([GZIP]), "both": delays([GZIP, PROMPT])}
compare(seen, {
    "defaults": ["0.2 s"] * 4,
    PROMPT: ["at once"] * 4,
    GZIP: ["with the next", "with the next", "0.2 s", "with the next"],
    "both": ["with the next", "with the next", "at once", "with the next"],
})
END
