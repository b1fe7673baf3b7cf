#!/usr/bin/env bash
# LCM 1.5.3 (PyPI) keeps the oldest messages for a slow reader, and drops the newest: scans stay seconds old.
#
# It is made for real-time robots, over UDP, and a subscription has a queue of 30. Expected when it is full: the oldest
# is dropped, as in ROS, and in LCM's own queue for Java and .NET (`MessageAggregator`). But a new message finds
# no place. So after a pause a reader gets what was sent at its beginning. One that takes a quarter of 40 scans a second
# gets each after 30 others, 3 s late, as long as it runs. `set_queue_capacity(1)` helps.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import time

from place import compare, network, pypi

pypi("lcm==1.5.3")
network()
import lcm  # noqa: E402

URL = "udpm://239.255.76.67:7667?ttl=0"
received = []
writer = lcm.LCM(URL)
sent = 0


def publish(count):
    global sent
    for _ in range(count):
        sent += 1
        # As large as a scan.
        writer.publish("SCAN", sent.to_bytes(4, "big") + bytes(4 * 682))
        # Time for the thread that receives.
        time.sleep(0.005)


def slow_reader(capacity):
    """What is received after a pause of 100 messages, and how old a message is if one of four is handled."""
    global sent
    reader = lcm.LCM(URL)
    subscription = reader.subscribe("SCAN", lambda _, data: received.append(int.from_bytes(data[:4], "big")))
    if capacity:
        subscription.set_queue_capacity(capacity)
    received.clear()
    sent = 0
    publish(100)
    while reader.handle_timeout(200):
        pass
    pause = received[0], received[-1], len(received)
    for _ in range(100):
        publish(4)
        reader.handle()
    return pause, sent - received[-1]


seen = {"default": slow_reader(None), "set_queue_capacity(1)": slow_reader(1)}
compare(seen, {"default": ((1, 30, 30), 119), "set_queue_capacity(1)": ((1, 1, 1), 3)})
END
