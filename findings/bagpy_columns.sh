#!/usr/bin/env bash
# bagpy 0.5 (PyPI) writes intensities of a LaserScan into the columns of ranges once the number of its points changes.
#
# Many scanners, such as an RPLIDAR, send another number of points in each scan. Expected of `message_by_topic`: an
# empty field or an error for a point that a scan does not have. Its header has the columns of the first message, and
# each row the fields of its own: an intensity of 100 silently becomes a range of 100 m. The method for LaserScans,
# `laser_data`, keeps the columns apart, but has 182 of each, and fails for longer scans. A URG-04LX sends 682.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import csv

from place import PLACE, compare, pypi

pypi("bagpy==0.5", "py3rosmsgs==1.18.2")
import rosbag  # noqa: E402
from bagpy import bagreader  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402


def open_bag(lengths):
    """A bag of scans with these numbers of points, which have ranges from 1 m on and intensities from 100 on."""
    path = str(PLACE / f"{len(lengths)}_{lengths[0]}.bag")
    with rosbag.Bag(path, "w") as bag:
        for second, length in enumerate(lengths):
            scan = LaserScan(ranges=[1.0 + at for at in range(length)], intensities=[100.0 + at for at in range(length)])
            bag.write("/scan", scan, rosbag.bag.genpy.Time(1 + second))
    return bagreader(path, verbose=False)


def columns(path):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    names = ["ranges_0", "ranges_1", "ranges_2", "intensities_0"]
    return [[row[name] for name in names] for row in rows]


def laser_data(lengths):
    try:
        return columns(open_bag(lengths).laser_data()[0])
    except IndexError as error:
        return str(error)


seen = {
    "ranges 0 to 2 and intensity 0, message_by_topic, 3 and 2 points": columns(open_bag([3, 2]).message_by_topic("/scan")),
    "laser_data, 3 and 2 points": laser_data([3, 2]),
    "laser_data, 183 points": laser_data([183]),
}
expected = [
    [["1.0", "2.0", "3.0", "100.0"], ["1.0", "2.0", "100.0", "101.0"]],
    [["1.0", "2.0", "3.0", "100.0"], ["1.0", "2.0", "", "100.0"]],
    "list assignment index out of range",
]
compare(seen, dict(zip(seen, expected)))
END
