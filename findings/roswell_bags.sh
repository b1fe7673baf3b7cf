#!/usr/bin/env bash
# roswell 0.1.0 (PyPI) writes a bag of LaserScans from which two readers silently take scans without ranges.
#
# An MCAP file holds the definition of each type, so that readers need no ROS. Expected of `roswell.bag`: the
# definition that its program was given. It leaves that empty, which is how a type without fields looks. So
# mcap-ros2-support 0.6.0 and pybag-sdk 0.13.0 yield messages without a field, and no error. rosbags 0.11.9 fails, and
# roswell itself reads the scan, with a definition of its own.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import PLACE, compare, network, pypi

pypi("roswell==0.1.0", "mcap-ros2-support==0.6.0", "pybag-sdk==0.13.0", "rosbags==0.11.9")
# For the node, which only reads the definition.
network()
import roswell.bag  # noqa: E402
from mcap.records import Schema  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from mcap_ros2.reader import read_ros2_messages  # noqa: E402
from pybag.mcap_reader import McapFileReader  # noqa: E402
from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: E402

FIELDS = ["angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"]
BAG = PLACE / "bag.mcap"
definition = PLACE / "sensor_msgs/msg/LaserScan.msg"
definition.parent.mkdir(parents=True)
floats = "".join(f"float32 {field}\n" for field in FIELDS)
definition.write_text(f"std_msgs/Header header\n{floats}float32[] ranges\nfloat32[] intensities\n")

scan = roswell.Node("recorder").load_type(definition).alloc()
scan.ranges = [1.0, 2.0, 3.0]
with roswell.bag.open_write(BAG) as bag:
    bag.write("/scan", scan, 0)


def with_rosbags():
    with AnyReader([BAG]) as reader:
        for connection, _, data in reader.messages():
            try:
                return list(reader.deserialize(data, connection.msgtype).ranges)
            except AnyReaderError as error:
                return str(error)


with BAG.open("rb") as file:
    schema = next(record for record in StreamReader(file).records if isinstance(record, Schema))
with McapFileReader.from_file(BAG) as reader:
    of_pybag = str(next(iter(reader.messages("/scan"))).data)
own = next(roswell.bag.read(BAG, type_paths=[str(PLACE)])).message
seen = {
    "definition in the file": (schema.name, schema.data.decode()),
    "mcap-ros2-support": str(next(iter(read_ros2_messages(str(BAG)))).ros_msg),
    "pybag-sdk": of_pybag,
    "rosbags": with_rosbags(),
    "roswell": list(own.ranges),
}
expected = [
    ("sensor_msgs/msg/LaserScan", ""),
    "LaserScan()",
    "sensor_msgs_msg_LaserScan()",
    "CDR message size mismatch for 'sensor_msgs/msg/LaserScan'.",
    [1.0, 2.0, 3.0],
]
compare(seen, dict(zip(seen, expected)))
END
