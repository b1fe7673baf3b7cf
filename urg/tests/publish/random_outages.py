"""Publishes for a time through outages at random: each ends with scans for every reader
within 10 s, and the memory of `urg` stays bounded.

random_outages.py PROGRAM RECORDING ENGINE MINUTES [SEED]

`urg` is killed only in the first sixth of the time. One process lives through all later
outages, and its memory is compared with its memory after the first of them.
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
GROWTH_KB = 8_192


def memory(process):
    """Returns the resident memory in kB."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())[1])


def load():
    return os.getloadavg()[0]


print(f"seed {SEED}", flush=True)
dice = random.Random(SEED)
place = outages.Place("random")
begin = time.monotonic()
minutes = lambda: (time.monotonic() - begin) / 60
first, peak, worst, count, late, times, said = None, 0, (0, ""), 0, 0, [], 0
while minutes() < MINUTES:
    kind = dice.choice(KINDS)
    if kind is outages.urg_killed and minutes() > MINUTES / 6:
        continue
    seconds = round(dice.choice([0.3, 2, 8, 15, 25, 40]) * dice.uniform(0.5, 1.2), 1)
    kind(place, seconds)
    over = time.time()
    count += 1
    took = 0
    for name, reader in place.readers.items():
        fresh = lambda: any(float(line[1]) >= over - 0.2 for line in reader.lines[-5:])
        while not fresh() and time.time() < over + 60:
            time.sleep(0.05)
        took = time.time() - over
        times.append(took)
        worst = max(worst, (took, f"{name}, {kind.__name__} {seconds} s"))
        if took > 10:
            late += 1
            print(f"LATE: {name}: no scan for {took:.1f} s", flush=True)
        del reader.lines[:-50]
    now = memory(place.urg.process)
    if kind is outages.urg_killed or first is None:
        first = peak = now
    peak = max(peak, now)
    said += len(place.urg.read())
    place.urg.said = ""
    print(f"{minutes():.1f} min, {kind.__name__} {seconds} s: back after {took:.1f} s, {now} kB, load {load():.1f}", flush=True)
    assert now < first + GROWTH_KB, f"the memory has grown from {first} to {now} kB"
    time.sleep(dice.uniform(1, 6))
times.sort()
print(f"{outages.ENGINE}: {count} random outages in {minutes():.0f} min, seed {SEED}: scans after {times[len(times) // 2]:.1f} s"
      f" (median), {worst[0]:.1f} s at most ({worst[1]}), {late} late; {first} kB at first, {peak} at most, {now} at the"
      f" end; {said} bytes of messages; load {load():.1f}", flush=True)
place.close()
assert not late, f"{late} of {count} outages"
os._exit(0)
