#!/usr/bin/env bash
# MRPT 2.5.8 (Debian 12) moves a part of a LaserScan by its whole width, unless the scan lies evenly around the front.
#
# Expected of its ROS bridge: each range keeps its angle, which the message states. But a scan of MRPT has no first
# angle, only a width around the front. What lies beyond that on one side is filled in on the other, as if all
# scanners saw 360 degrees: a wall seen from 60 to 90 degrees stands from -60 to -30. The bridge also rounds indices
# down, so that a scan from -60 to 60 degrees turns by a step. The bridge for ROS 2 has the same lines.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import subprocess

from place import compare, mrpt

BRIDGE = "libmrpt-ros1bridge2.5"
HEADERS = [f"libmrpt-{name}-dev" for name in (
    "common", "config", "containers", "core", "math", "obs", "opengl", "poses", "ros1bridge", "rtti",
    "serialization", "system", "tfest", "typemeta")]
HEADERS += ["libboost1.74-dev", "libeigen3-dev", "libgeometry-msgs-dev", "libroscpp-core-dev", "libsensor-msgs-dev",
            "libstd-msgs-dev"]

PROGRAM = """
#include <iostream>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/ros1bridge/laser_scan.h>
#include <sensor_msgs/LaserScan.h>

int main(int, char** arguments) {
    const double first = std::stod(arguments[1]), last = std::stod(arguments[2]), step = 0.25;
    sensor_msgs::LaserScan message;
    message.angle_min = first * M_PI / 180;
    message.angle_max = last * M_PI / 180;
    message.angle_increment = step * M_PI / 180;
    message.range_min = 0.02;
    message.range_max = 30;
    const int rays = (last - first) / step + 1;
    // The number of a ray, in millimetres beyond a metre.
    for (int ray = 0; ray < rays; ray++) message.ranges.push_back(1 + ray * 0.001);
    mrpt::obs::CObservation2DRangeScan scan;
    mrpt::ros1bridge::fromROS(message, {}, scan);
    int near = 0, far = 0;
    for (int index = 0; index < rays; index++) {
        const double is = (index / (rays - 1.0) - 0.5) * scan.aperture * 180 / M_PI;
        const double was = first + std::round((scan.getScanRange(index) - 1) * 1000) * step;
        const double error = std::abs(is - was);
        near += error > step / 4 && error < step * 1.1;
        far += error > 119 && error < 121;
    }
    std::cout << rays << " rays, " << near << " by up to a step, " << far << " by 120 degrees";
}
"""

program = mrpt(PROGRAM, BRIDGE, extra=HEADERS,
               links=["ros1bridge", "obs", "poses", "serialization", "rtti", "math", "core"])


def moved(first, last):
    run = [program, str(first), str(last)]
    return subprocess.run(run, capture_output=True, text=True, check=True).stdout


windows = [(-135, 135), (-60, 60), (-60, 60.25), (-30, 90)]
seen = {f"from {first} to {last} degrees": moved(first, last) for first, last in windows}
expected = [
    "1081 rays, 0 by up to a step, 0 by 120 degrees",
    "481 rays, 480 by up to a step, 0 by 120 degrees",
    "482 rays, 482 by up to a step, 0 by 120 degrees",
    "481 rays, 360 by up to a step, 120 by 120 degrees",
]
compare(seen, dict(zip(seen, expected)))
END
