"""Removes the interface of `urg publish` and makes it again with the same address, as container
networks, USB adapters and VPNs do: readers of ROS 2 that start later get scans.

interfaces.py PROGRAM RECORDING [SEED]
"""

import os
import random
import sys
import threading
import time

from common import Urg, ok
from namespaces import ROS_READER, Lines, Namespace, ip, use

SEED = int(sys.argv[3]) if sys.argv[3:] else random.randrange(10**6)
PLACES, TIMES = 4, 5
# Limit from the return of the interface, with the start of rclpy on a busy machine.
SECONDS = 30


class Place:
    """`urg` and its readers on a switch."""

    def __init__(self):
        self.switch, self.robot, self.desk = Namespace(), Namespace(), Namespace()
        ip("link add br0 type bridge", self.switch.enter)
        ip("link set br0 up", self.switch.enter)
        self.plug(self.robot, 1)
        self.plug(self.desk, 2)

    def plug(self, place, number):
        ip(f"link add p{number} type veth peer name n0 netns {place.process.pid}", self.switch.enter)
        ip(f"link set p{number} master br0 up", self.switch.enter)
        use("n0", f"10.6.0.{number}", place.enter)
        ip("route replace 224.0.0.0/4 dev n0", place.enter)

    def run(self, gaps, failures):
        try:
            with Urg("publish", "emulated", enter=self.robot.enter) as urg:
                steady = Lines(ROS_READER, namespace=self.desk)
                steady.more(10, 60)
                for gap in gaps:
                    ip("link del n0", self.robot.enter)
                    time.sleep(gap)
                    self.plug(self.robot, 1)
                    begin = time.monotonic()
                    late = Lines(ROS_READER, namespace=self.desk)
                    late.more(10, SECONDS), steady.more(10, SECONDS)
                    print(f"{gap:.1f} s: both have scans after {time.monotonic() - begin:.1f} s", flush=True)
                    late.kill()
                said = urg.stop()
                assert said.count("the network interfaces have changed") >= len(gaps), said
        except BaseException as error:
            failures.append(f"{gaps}: {error!r}: {urg.read()}")


def main():
    dice = random.Random(SEED)
    failures, threads = [], []
    for _ in range(PLACES):
        gaps = [dice.choice([0.1, 0.2, 0.4, 0.7, 1, 2, 5]) for _ in range(TIMES)]
        threads.append(threading.Thread(target=Place().run, args=(gaps, failures)))
    for thread in threads:
        thread.start()
        time.sleep(1)
    for thread in threads:
        thread.join()
    assert not failures, f"seed {SEED}: {failures}"
    ok(f"an interface that was made again {PLACES * TIMES} times is used (seed {SEED})")


main()
os._exit(0)
