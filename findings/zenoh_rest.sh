#!/usr/bin/env bash
# zenoh 1.10.2 (crates.io): one reader of the REST plugin that stops reading halts its router, for all and all keys.
#
# The plugin sends a topic as server-sent events to a browser, which may be on a laptop that sleeps. Expected: that
# reader loses events or its connection, and others get theirs. But the plugin keeps 256 messages for it, and then the
# router's thread that receives them waits. It has two such threads. So with one publisher of that topic, none of its
# messages pass, whatever their key. With two, nobody's do, although all sessions stay open, until the reader reads
# again or its connection ends.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import json
import socket
import threading
import time

from place import cargo, compare, connect, free_port, pypi, run

# Does what zenohd does with its configuration.
ROUTER = """
use zenoh::Wait;
use zenoh_plugin_rest as _;

fn main() {
    let config = zenoh::Config::from_json5(&std::env::args().nth(1).unwrap()).unwrap();
    let _session = zenoh::open(config).wait().unwrap();
    std::thread::park();
}
"""
pypi("eclipse-zenoh==1.10.2")
import zenoh  # noqa: E402

program = cargo(ROUTER, 'zenoh-plugin-rest = "=1.10.2"',
                'zenoh = { version = "=1.10.2", features = ["internal", "plugins", "runtime_plugins", "unstable"] }')
plugin = next(program.parent.glob("deps/libzenoh_plugin_rest-*.so"))


def session(port):
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(configuration)


def publish(port, keys, over):
    with session(port) as publisher:
        while not over.wait(0.01):
            for key in keys:
                publisher.put(key, bytes(2788))


def drain(client):
    with contextlib.suppress(OSError):
        while client.recv(1_000_000):
            pass


def follow(received):
    """Returns the keys whose messages arrive within two seconds."""
    received.clear()
    time.sleep(2)
    return sorted(received)


def keys(sensors, is_read):
    """Returns the keys that arrive while somebody else reads the scans over REST or does not, and afterwards."""
    port, rest = free_port(), free_port()
    router = run(program, json.dumps({
        "mode": "router",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
        "plugins_loading": {"enabled": True},
        "plugins": {"rest": {"http_port": f"127.0.0.1:{rest}", "__path__": str(plugin), "__required__": True}},
    }))
    connect(port).close()
    over, received = threading.Event(), set()
    reader = session(port)
    reader.declare_subscriber("**", lambda sample: received.add(str(sample.key_expr)))
    threads = [threading.Thread(target=publish, args=[port, [f"scan/{sensor}", f"state/{sensor}"], over])
               for sensor in sensors]
    threads.append(threading.Thread(target=publish, args=[port, ["stop"], over]))
    for thread in threads:
        thread.start()
    with connect(rest) as client:
        client.sendall(b"GET /scan/** HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\n\r\n")
        if is_read:
            threading.Thread(target=drain, args=[client], daemon=True).start()
        time.sleep(30)
        meanwhile = follow(received)
        client.shutdown(socket.SHUT_RDWR)
    time.sleep(1)
    afterwards = follow(received)
    over.set()
    for thread in threads:
        thread.join()
    reader.close()
    router.kill()
    return meanwhile, afterwards


ONE = ["scan/front", "state/front", "stop"]
TWO = ["scan/front", "scan/rear", "state/front", "state/rear", "stop"]
seen = {
    "one, read": keys(["front"], True),
    "one, not read": keys(["front"], False),
    "two, read": keys(["front", "rear"], True),
    "two, not read": keys(["front", "rear"], False),
}
compare(seen, {
    "one, read": (ONE, ONE),
    "one, not read": (["stop"], ONE),
    "two, read": (TWO, TWO),
    "two, not read": ([], TWO),
})
END
