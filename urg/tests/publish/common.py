"""Starts `urg`, and knows what a recording's messages must be."""

import json
import math
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

PROGRAM = sys.argv[1]
RECORDING = Path(sys.argv[2])
BEYOND_RANGE = {0, 6, 16, 4095}
# Angles are single precision, which is worth some nanoseconds; NDJSON has microseconds.
TOLERANCE = 2_000


def end(*failure):
    """Ends with a failure at once. Threads and sessions of a reader would keep the process."""
    traceback.print_exception(*failure)
    os._exit(1)


sys.excepthook = end
threading.excepthook = lambda failure: end(*failure[:3])


def single(number):
    """Returns the nearest number of single precision."""
    return struct.unpack("<f", struct.pack("<f", number))[0]


def range_of(value):
    if value in BEYOND_RANGE:
        return math.inf
    return math.nan if value < 20 else single(value / 1000)


def truth():
    """Returns stamp and ranges of each scan of the recording, as a driver delivers them."""
    scans = []
    for line in RECORDING.with_suffix(".ndjson").read_text().splitlines():
        scan = json.loads(line)
        if "event" in scan:
            continue
        from_rear = scan["angle_min"] / math.tau + 0.5
        stamp = round(scan["stamp"] * 1e9 - (1 - from_rear) * 1e8)
        scans.append((stamp, [range_of(value) for value in scan["values"]]))
    assert len(scans) > 20, "a recording of so few scans proves nothing"
    return scans


def same(left, right):
    return len(left) == len(right) and all(
        a == b or math.isnan(a) and math.isnan(b) for a, b in zip(left, right)
    )


def compare(name, received, may_begin_late=True):
    """Fails unless `received`, pairs of a stamp and ranges, is the recording. A reader
    that discovers its publisher late misses the first ones, and none after that."""
    expected = truth()
    assert received, f"{name}: nothing was received"
    first = next(
        (i for i, (stamp, _) in enumerate(expected) if abs(stamp - received[0][0]) <= TOLERANCE),
        None,
    )
    assert first is not None, f"{name}: the first stamp {received[0][0]} is not in the recording"
    assert may_begin_late or first == 0, f"{name}: the first {first} scans are missing"
    assert first < len(expected) / 2, f"{name}: began only with scan {first}"
    expected = expected[first:]
    assert len(received) == len(expected), f"{name}: {len(received)} scans of {len(expected)}"
    for number, ((stamp, ranges), (true_stamp, true_ranges)) in enumerate(zip(received, expected)):
        assert abs(stamp - true_stamp) <= TOLERANCE, f"{name}: scan {number} has another stamp"
        assert same(ranges, true_ranges), f"{name}: scan {number} has other ranges"
    print(f"ok: {name}: {len(received)} scans, every value the same", flush=True)


def ok(name):
    print(f"ok: {name}", flush=True)


class Urg:
    """A running `urg`; the end of the block stops it as Ctrl-C does."""

    def __init__(self, *arguments, enter=()):
        """`enter` is a command that runs the program elsewhere."""
        self.process = subprocess.Popen(
            [*enter, PROGRAM, *map(str, arguments)],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        os.set_blocking(self.process.stderr.fileno(), False)
        self.said = ""

    def __enter__(self):
        return self

    def __exit__(self, failure, *_):
        # A failure of the block is what is to be seen.
        self.stop() if failure is None else self.kill()

    def stop(self):
        """Stops it; returns all that it wrote to standard error."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(timeout=10)
        self.read()
        assert code == 0, f"urg ended with {code}: {self.said}"
        return self.said

    def kill(self):
        self.process.kill()
        self.process.wait()

    def read(self):
        try:
            while piece := os.read(self.process.stderr.fileno(), 65536):
                self.said += piece.decode()
        except BlockingIOError:
            pass
        return self.said

    def wait_for(self, words, seconds=15):
        wait(f"urg says {words!r}", lambda: words in self.read(), seconds)

    def wait(self, seconds=60):
        code = self.process.wait(timeout=seconds)
        assert code == 0, f"urg ended with {code}: {self.read()}"


def wait(what, condition, seconds=15, step=lambda: time.sleep(0.02)):
    """Waits until `condition` holds. Fails after `seconds`, which are for a machine that
    is busy; nothing depends on them otherwise."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds} s in vain: {what}"
        step()
