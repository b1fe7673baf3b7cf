"""Publishes for a time through outages at random: each ends with scans for every reader
within 10 s, and the memory of `urg` stays bounded.

random_outages.py PROGRAM RECORDING ENGINE MINUTES [SEED]
"""

import os
import random
import re
import sys
import time
from pathlib import Path

import outages

MINUTES = float(sys.argv[4])
SEED = int(sys.argv[5]) if len(sys.argv) > 5 else random.randrange(10**6)
KINDS = outages.KINDS


def memory(process):
    """Returns the resident memory in kB."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())[1])


print(f"seed {SEED}", flush=True)
dice = random.Random(SEED)
place = outages.Place("random")
end = time.monotonic() + 60 * MINUTES
first, worst, count, failed = None, 0, 0, 0
while time.monotonic() < end:
    kind, seconds = dice.choice(KINDS), round(dice.choice([0.3, 2, 8, 15, 25, 40]) * dice.uniform(0.5, 1.2), 1)
    kind(place, seconds)
    over = time.time()
    count += 1
    for name, reader in place.readers.items():
        fresh = lambda: any(float(line[1]) >= over - 0.2 for line in reader.lines[-5:])
        while not fresh() and time.time() < over + 60:
            time.sleep(0.05)
        took = time.time() - over
        worst = max(worst, took)
        if took > 10:
            failed += 1
            print(f"FAILED: {kind.__name__} {seconds} s: {name} had no scan for {took:.1f} s", flush=True)
        del reader.lines[:-50]
    now = memory(place.urg.process)
    if kind is outages.urg_killed or first is None:
        first = now
    print(f"{kind.__name__} {seconds} s: back, {now} kB", flush=True)
    assert now < first + 8_192, f"the memory has grown from {first} to {now} kB"
    time.sleep(dice.uniform(1, 6))
place.close()
assert not failed, f"{failed} of {count} outages"
print(f"ok: {outages.ENGINE}: {count} random outages in {MINUTES:g} min, scans again after at most {worst:.1f} s")
os._exit(0)
