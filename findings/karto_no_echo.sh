#!/usr/bin/env bash
# OpenKarto (karto-scanmatcher 1.0.0, PyPI), as in slam_toolbox 2.7.0: a ray of +Inf frees nothing in its map.
#
# REP 117 has +Inf for a ray that met nothing up to the limit. Expected: it frees the map up to the range threshold,
# as a ray of 9.9 m does if the threshold is 5 m and the limit 10 m. It is left out, as NaN is: an open hall stays
# unknown.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import math

from place import compare, pypi

pypi("karto-scanmatcher==1.0.0", "numpy==2.2.6")
from karto_scanmatcher import LaserScanConfig, LocalizedRangeScan, Pose2, create_occupancy_grid  # noqa: E402

STEP = math.radians(1)
RESOLUTION, LIMIT, THRESHOLD = 0.1, 10, 5
STATES = {0: "unknown", 100: "occupied", 255: "free"}


def ahead(metres):
    """The map one metre in front of a scanner, which sees this ahead, and a wall at 4 m on both sides."""
    config = LaserScanConfig(-90 * STEP, 90 * STEP, STEP, 0.1, LIMIT, THRESHOLD, "scanner")
    ranges = [4.0] * 60 + [metres] * 61 + [4.0] * 60
    place = Pose2(0, 0, 0)
    scans = [LocalizedRangeScan(config, ranges, place, place, number, number) for number in range(3)]
    grid = create_occupancy_grid(scans, RESOLUTION, THRESHOLD)
    column, row = (round((to - begin) / RESOLUTION) for to, begin in [(1, grid.offset.x), (0, grid.offset.y)])
    return STATES[grid.get_value(column, row)]


seen = {metres: ahead(metres) for metres in [3.0, 9.9, math.inf, math.nan]}
compare(seen, dict(zip(seen, ["free", "free", "unknown", "unknown"])))
END
