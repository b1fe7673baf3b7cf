#!/usr/bin/env bash
# small_gicp 1.0.1 (PyPI) finds no motion between two scans of a room with 1 mm of noise, and reports that it converged.
#
# A scan is a cloud whose points all have z = 0. Expected of PLANE_ICP: the motion, as between scans without noise,
# which a test would use. But it takes the direction in which neighbouring points vary least for a wall's normal. That
# is up, as soon as noise moves the points of a wall: then no motion has an error. Scans that are repeated at four
# heights give the motion.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import math
import random

from place import compare, pypi

pypi("small-gicp==1.0.1", "numpy==2.2.6")
import numpy  # noqa: E402
import small_gicp  # noqa: E402

# Metres and degrees.
MOTION = (0.1, 0.05, 3)


def distance(x, y, direction):
    """To the wall of a room of 8 m by 5 m that a ray meets."""
    dx, dy = math.cos(direction), math.sin(direction)
    return min(((5 if dx > 0 else -3) - x) / dx, ((3 if dy > 0 else -2) - y) / dy)


def scan(pose, noise, heights):
    x, y, degrees = pose
    generator = random.Random(x)
    points = []
    for step in range(1081):
        angle = math.radians(step / 4 - 134.9)
        range_ = distance(x, y, angle + math.radians(degrees)) + generator.gauss(0, noise)
        points += [(range_ * math.cos(angle), range_ * math.sin(angle), z) for z in heights]
    return numpy.array(points)


seen = {}
for name, noise, heights in [
    ("without noise", 0, [0]),
    ("1 mm of noise", 0.001, [0]),
    ("10 mm", 0.01, [0]),
    ("10 mm, at four heights", 0.01, [0, 0.1, 0.2, 0.3]),
]:
    clouds = [scan(pose, noise, heights) for pose in [(0, 0, 0), MOTION]]
    found = small_gicp.align(*clouds, registration_type="PLANE_ICP")
    moved = found.T_target_source
    yaw = math.degrees(math.atan2(moved[1, 0], moved[0, 0]))
    # `+ 0` makes -0.0 zero.
    seen[name] = [round(float(moved[0, 3]), 2) + 0, round(float(moved[1, 3]), 2) + 0, round(yaw), found.converged]
compare(seen, {
    "without noise": [0.1, 0.05, 3, True],
    "1 mm of noise": [0.0, 0.0, 0, True],
    "10 mm": [0.0, 0.0, 0, True],
    "10 mm, at four heights": [0.1, 0.05, 3, True],
})
END
