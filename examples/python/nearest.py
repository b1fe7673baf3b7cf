"""Reads the lines of `urg stream` with NumPy: the nearest point of each scan.

urg stream /dev/ttyACM0 --wait | python3 nearest.py     # or: urg stream emulated
"""

import json
import sys

import numpy as np

for line in sys.stdin:
    scan = json.loads(line)
    if "event" in scan:  # such as a lost link: the scans go on after it
        print(scan["event"], file=sys.stderr)
        continue
    ranges = np.array(scan["ranges"], dtype=float)  # metres, NaN without a distance
    angles = scan["angle_min"] + scan["angle_increment"] * np.arange(len(ranges))
    if np.isnan(ranges).all():
        continue
    nearest = np.nanargmin(ranges)
    x, y = ranges[nearest] * np.cos(angles[nearest]), ranges[nearest] * np.sin(angles[nearest])
    print(f"scan {scan['sequence']}: {x:.3f} m ahead, {y:.3f} m to the left", flush=True)
