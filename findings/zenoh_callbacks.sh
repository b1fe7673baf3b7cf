#!/usr/bin/env bash
# eclipse-zenoh 1.10.2 (PyPI): a slow callback for scans delays the other callbacks of its session by seconds.
#
# Its documentation says that a callback gets its data on a separate thread by default, so that "the network thread is
# not blocked". Expected of a callback that takes 0.1 s for each of 100 messages a second: old messages there, and
# "stop", at another key, on time. But a channel of 256 messages lies before that thread. Once it is full, the network
# thread waits, and "stop" comes later and later, although its own callback is fast. With `RingChannel(1)` for the
# scans, and a loop on a thread, both are on time.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import threading
import time

from place import compare, free_port, pypi

pypi("eclipse-zenoh==1.10.2")
import zenoh  # noqa: E402

ADDRESS = f'["tcp/127.0.0.1:{free_port()}"]'


def session(mode, key):
    configuration = zenoh.Config()
    configuration.insert_json5("mode", f'"{mode}"')
    configuration.insert_json5(key, ADDRESS)
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(configuration)


def delays(is_callback):
    """Sends scans for 12 s, and "stop" once a second. Returns how old each was that came in that time."""
    over, stops = threading.Event(), []

    def on_stop(sample):
        stops.append(time.time() - float(sample.payload.to_string()))

    def on_scan(_):
        over.wait(0.1)

    def read(subscriber):
        for sample in subscriber:
            on_scan(sample)

    reader = session("client", "connect/endpoints")
    reader.declare_subscriber("stop", on_stop)
    if is_callback:
        reader.declare_subscriber("scan", on_scan)
    else:
        subscriber = reader.declare_subscriber("scan", zenoh.handlers.RingChannel(1))
        threading.Thread(target=read, args=[subscriber], daemon=True).start()
    time.sleep(1)
    for number in range(1200):
        scan.put(bytes(2788))
        if number % 100 == 0:
            stop.put(str(time.time()))
        time.sleep(0.01)
    received = list(stops)
    over.set()
    reader.close()
    return received


router = session("router", "listen/endpoints")
stop, scan = router.declare_publisher("stop"), router.declare_publisher("scan")
seen = {}
for name, is_callback in [("RingChannel", False), ("callback", True)]:
    received = delays(is_callback)
    print(f"{name}: seconds until stop, for {len(received)} of 12:", [round(delay, 1) for delay in received])
    seen[f"{name}, the first on time"] = received[0] < 0.5
    seen[f"{name}, all on time"] = len(received) == 12 and max(received) < 0.5
router.close()
compare(seen, {
    "RingChannel, the first on time": True,
    "RingChannel, all on time": True,
    "callback, the first on time": True,
    "callback, all on time": False,
})
END
