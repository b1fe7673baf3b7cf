#!/usr/bin/env bash
# sseclient 0.0.27 (PyPI) cuts an event that arrives in two chunks of HTTP, without an error.
#
# A proxy such as nginx sends a scan of 16 kB in several chunks, as HTTP permits. Expected: the whole event. The client
# reads the connection below its decoder of chunks, so that their lengths become lines of the event: data ends with the
# first chunk. It also yields an event without data for each comment, which servers send to keep a stream alive.
# httpx-sse 0.4.3 (PyPI) does neither.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import itertools
import socket
import threading

from place import compare, pypi

pypi("sseclient==0.0.27", "requests==2.34.2", "httpx-sse==0.4.3", "httpx==0.28.1")
import httpx  # noqa: E402
from httpx_sse import connect_sse  # noqa: E402
from sseclient import SSEClient  # noqa: E402

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
EVENT = b"data: " + b",".join([b"1234"] * 1000) + b"\n\n"
SENT = {"one chunk": [EVENT], "two chunks": [EVENT[:2006], EVENT[2006:]], "a comment before": [b":\n\n", EVENT]}


def answer(listener, chunks):
    client, _ = listener.accept()
    with contextlib.suppress(OSError), client:
        client.recv(10_000)
        # Further events show where the first one ends.
        client.sendall(HEAD + b"".join(b"%x\r\n%b\r\n" % (len(chunk), chunk) for chunk in [*chunks, EVENT, EVENT]))
        client.recv(1)


def sseclient(url):
    return SSEClient(url)


def httpx_sse(url):
    with httpx.Client() as client, connect_sse(client, "GET", url) as source:
        yield from source.iter_sse()


def values(read, chunks):
    """Returns how many values the first event has, and how many the second."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=answer, args=[listener, chunks], daemon=True).start()
        events = itertools.islice(read(f"http://127.0.0.1:{listener.getsockname()[1]}/"), 2)
        return [event.data.count("1234") for event in events]


seen = {(read.__name__, name): values(read, chunks) for read in (sseclient, httpx_sse) for name, chunks in SENT.items()}
compare(seen, {
    ("sseclient", "one chunk"): [1000, 1000],
    ("sseclient", "two chunks"): [400, 1000],
    ("sseclient", "a comment before"): [0, 1000],
    ("httpx_sse", "one chunk"): [1000, 1000],
    ("httpx_sse", "two chunks"): [1000, 1000],
    ("httpx_sse", "a comment before"): [1000, 1000],
})
END
