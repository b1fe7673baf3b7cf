#!/usr/bin/env bash
# Varnish 7.1.1 and lighttpd 1.4.69 (Debian 12) keep all events for a client that stops reading, which gets them later.
#
# Expected: the proxy stops reading, as Apache 2.4.71 and Squid 5.7 of Debian 12 do, so that the server notices and can
# skip old scans. Varnish keeps them in memory, unless its VCL pipes the request: the parameter `transit_buffer` of newer
# versions does not exist yet. lighttpd keeps them in files with `server.stream-response-body = 1`, but not with 2.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import socket
import threading
import time

from place import PLACE, compare, connect, debian, free_port, run

EVENTS = 4000
EVENT = b"data: " + b"1234," * 3200 + b"\n\n"
HEAD = (b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n")


def send(client, sent):
    with contextlib.suppress(OSError), client:
        client.recv(10_000)
        client.sendall(HEAD)
        for _ in range(EVENTS):
            client.sendall(b"%x\r\n%b\r\n" % (len(EVENT), EVENT))
            sent.append(time.monotonic())
        client.recv(1)


def backlog(start, lines):
    """Returns whether the proxy takes all 64 MB, of which its client reads the first bytes."""
    sent, port = [], free_port()
    listener = socket.create_server(("127.0.0.1", 0))
    start(port, listener.getsockname()[1], lines)
    connect(port).close()
    threading.Thread(target=lambda: send(listener.accept()[0], sent), daemon=True).start()
    with connect(port) as client:
        client.sendall(b"GET /scans HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\n\r\n")
        client.recv(1000)
        while len(sent) < EVENTS and (not sent or time.monotonic() - sent[-1] < 3):
            time.sleep(0.1)
    return "all" if len(sent) == EVENTS else "a part"


def varnish(port, server, lines):
    folder = PLACE / f"varnish{port}"
    folder.mkdir()
    (folder / "vcl").write_text("\n".join([
        "vcl 4.0;", f'backend default {{ .host = "127.0.0.1"; .port = "{server}"; }}', *lines]))
    run(root / "usr/sbin/varnishd", "-F", "-j", "none", "-n", folder, "-a", f"127.0.0.1:{port}", "-f", folder / "vcl")


def lighttpd(port, server, lines):
    file = PLACE / f"lighttpd{port}.conf"
    file.write_text("\n".join([
        'server.modules = ("mod_proxy")', f'server.document-root = "{PLACE}"', f'server.upload-dirs = ("{PLACE}")',
        f'server.bind = "127.0.0.1"\nserver.port = {port}',
        f'proxy.server = ("" => (("host" => "127.0.0.1", "port" => {server})))', *lines]))
    run(root / "usr/sbin/lighttpd", "-D", "-f", file, "-m", root / "usr/lib/lighttpd")


root = debian("varnish=7.1.1-2+deb12u1", "libjemalloc2=5.3.0-1", "lighttpd=1.4.69-1")
PIPE = 'sub vcl_recv { if (req.url == "/scans") { return (pipe); } }'
STREAM = "server.stream-response-body = "
seen = {
    "varnish": backlog(varnish, []),
    "varnish, pipe": backlog(varnish, [PIPE]),
    "lighttpd, 1": backlog(lighttpd, [STREAM + "1"]),
    "lighttpd, 2": backlog(lighttpd, [STREAM + "2"]),
}
compare(seen, {"varnish": "all", "varnish, pipe": "a part", "lighttpd, 1": "all", "lighttpd, 2": "a part"})
END
