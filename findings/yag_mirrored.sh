#!/usr/bin/env bash
# yag-slam 0.3.0 (PyPI), a SLAM of its own on OpenKarto, mirrors the LaserScans that it reads, unless told otherwise.
#
# `LocalizedRangeScan.from_json` takes the fields of a LaserScan and its pose. Expected: a wall on the left lies on the
# left. It reverses the ranges by default and keeps the angles, so the wall lies on the right. `GraphSlam` then believes
# the scans and not the odometry: a robot that turns left by 27 degrees, with exact odometry, turns right by 27 in its
# map, and no error shows it. With `invert=False` all is well.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import math

from place import compare, pypi

pypi("yag-slam==0.3.0", "karto-scanmatcher==1.0.0", "numpy==2.2.6", "opencv-python-headless==4.12.0.88")
from yag_slam.graph_slam import GraphSlam  # noqa: E402
from yag_slam.helpers import default_config  # noqa: E402
from yag_slam.models import LocalizedRangeScan  # noqa: E402
from yag_slam.scan_matching import Scan2DMatcherCpp  # noqa: E402

STEP = math.radians(1)
# Direction and distance of each wall, from the origin: the one on the left is nearer than the one on the right.
WALLS = [(0, 5.0), (90, 1.5), (180, 2.0), (-90, 3.0)]


def laser_scan(x, heading):
    """A scan in a room, from x on its middle line."""
    ranges = []
    for ray in range(-90, 91):
        walls = []
        for direction, distance in WALLS:
            toward = math.cos(heading + ray * STEP - math.radians(direction))
            if toward > 1e-9:
                walls.append((distance - x * math.cos(math.radians(direction))) / toward)
        ranges.append(min(walls))
    return {"ranges": ranges, "angle_min": -90 * STEP, "angle_max": 90 * STEP, "angle_increment": STEP,
            "range_min": 0.02, "range_max": 10.0}


def walls_beside(**options):
    """The distances of the walls on the left and on the right."""
    _, across = LocalizedRangeScan.from_json(laser_scan(0, 0), 0, 0, 0, **options).points()
    return f"{max(across):.1f} m left, {-min(across):.1f} m right"


def heading_after_turn(**options):
    """The heading in the map after ten scans, each 3 degrees farther left, all with their true pose."""
    slam = GraphSlam(Scan2DMatcherCpp(default_config), None)
    for number in range(10):
        x, heading = 0.1 * number, 3 * number * STEP
        slam.process_scan(LocalizedRangeScan.from_json(laser_scan(x, heading), x, 0, heading, **options))
    return f"{math.degrees(slam.graph.vertices[-1].obj.corrected_pose.euler[-1]):+.0f} degrees"


seen = {
    "walls": walls_beside(),
    "walls, invert=False": walls_beside(invert=False),
    "turned left by 27 degrees": heading_after_turn(),
    "turned left by 27 degrees, invert=False": heading_after_turn(invert=False),
}
compare(seen, {
    "walls": "3.0 m left, 1.5 m right",
    "walls, invert=False": "1.5 m left, 3.0 m right",
    "turned left by 27 degrees": "-27 degrees",
    "turned left by 27 degrees, invert=False": "+27 degrees",
})
END
