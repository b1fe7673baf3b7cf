#!/usr/bin/env bash
# zenoh-ros2-sdk 0.1.8 (PyPI): without the Internet, as on most robots, a subscriber of a LaserScan gets nothing.
#
# Asked for a LaserScan alone, it fails, and says: "Please provide msg_definition". Expected with that: scans, or an
# error that names what is still missing, the definition of std_msgs/msg/Header. It logs that its download of that
# failed, and computes the hash of the type without it. So it waits for scans at a key of its own. rmw_zenoh publishes
# them at another, where a reader of all keys gets them. It also adds a line to the user's ~/.gitconfig.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import time

from place import PLACE, compare, network, pypi

pypi("zenoh-ros2-sdk==0.1.8", "eclipse-zenoh==1.10.2")
# What it downloads and writes.
os.environ["HOME"] = str(PLACE)
network()
import zenoh  # noqa: E402
from zenoh_ros2_sdk import ROS2Subscriber  # noqa: E402

# Of Jazzy and Kilted.
HASH = "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
KEY = f"0/scan/sensor_msgs::msg::dds_::LaserScan_/{HASH}"
DEFINITION = """std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
"""
# A message without points: CDR, little-endian, and zeros up to both lengths.
SCAN = bytes([0, 1, 0, 0]) + bytes(8 + 4 + 4 + 7 * 4 + 2 * 4)

configuration = zenoh.Config()
configuration.insert_json5("mode", '"router"')
configuration.insert_json5("listen/endpoints", '["tcp/127.0.0.1:7447"]')
configuration.insert_json5("scouting/multicast/enabled", "false")
router = zenoh.open(configuration)
seen = {}
try:
    ROS2Subscriber("/scan", "sensor_msgs/msg/LaserScan", print)
except ValueError as error:
    seen["without a definition"] = str(error).partition("provided. ")[2].partition(" or ")[0]
scans, samples = [], []
subscriber = ROS2Subscriber("/scan", "sensor_msgs/msg/LaserScan", scans.append, msg_definition=DEFINITION)
everything = router.declare_subscriber("*/scan/**", samples.append)
publisher = router.declare_publisher(KEY)
time.sleep(1)
publisher.put(SCAN)
time.sleep(1)
seen["with one, its hash"] = "right" if subscriber.type_hash == HASH else "wrong"
seen["scans that it gets"] = len(scans)
seen["scans at all keys"] = len(samples)
seen["~/.gitconfig"] = (PLACE / ".gitconfig").read_text().split()[:2]
subscriber.session_mgr.close()
router.close()
compare(seen, {
    "without a definition": "Please provide msg_definition",
    "with one, its hash": "wrong",
    "scans that it gets": 0,
    "scans at all keys": 1,
    "~/.gitconfig": ["[safe]", "directory"],
})
END
