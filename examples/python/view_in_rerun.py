"""Shows the lines of `urg stream` live in the viewer Rerun.

urg stream /dev/ttyACM0 | python3 view_in_rerun.py     # or: urg stream emulated
"""

import json
import sys

import numpy as np
import rerun

rerun.init("urg", spawn=True)
for line in sys.stdin:
    scan = json.loads(line)
    if "event" in scan:  # such as a lost link
        continue
    ranges = np.array(scan["ranges"], dtype=float)  # metres, NaN without a distance
    angles = scan["angle_min"] + scan["angle_increment"] * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    ranges, angles = ranges[seen], angles[seen]
    points = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    rerun.set_time("first_ray", timestamp=scan["first_ray"])
    rerun.log("laser", rerun.Points2D(points))
