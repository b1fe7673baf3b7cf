"""Reads a recording into a NumPy array, a row for each scan: pip install numpy mcap-ros2-support

urg record emulated run.mcap --count 50 && python3 recording.py run.mcap
"""

import sys

import numpy as np
from mcap_ros2.reader import read_ros2_messages

scans = [message.ros_msg for message in read_ros2_messages(sys.argv[1], topics=["/scan"])]
ranges = np.array([scan.ranges for scan in scans])  # metres; inf or NaN without a distance
stamps = np.array([scan.header.stamp.sec + scan.header.stamp.nanosec / 1e9 for scan in scans])
angles = scans[0].angle_min + scans[0].angle_increment * np.arange(ranges.shape[1])

ranges[~np.isfinite(ranges)] = np.nan
seen = ~np.isnan(ranges).all(axis=0)  # in these directions there is a distance
x, y = np.nanmedian(ranges[:, seen], axis=0) * (np.cos(angles[seen]), np.sin(angles[seen]))
print(f"{len(scans)} scans of {len(angles)} points, {1 / np.diff(stamps).mean():.2f} a second")
print(f"the room: {np.nanmin(x):.2f} to {np.nanmax(x):.2f} m ahead,", end=" ")
print(f"{np.nanmin(y):.2f} to {np.nanmax(y):.2f} m to the left")
