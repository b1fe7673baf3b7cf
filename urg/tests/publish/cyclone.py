"""Reads what `urg publish` publishes with Cyclone DDS, without ROS: scans, and the places of
sensors (of whose message no package of ROS can be installed by pip).

cyclone.py PROGRAM RECORDING
"""

import math
import os
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, sequence, uint32
from cyclonedds.core import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from common import RECORDING, Urg, compare, ok, wait


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1000))
reader = DataReader(participant, Topic(participant, "rt/scan", LaserScan), qos=qos)
got = []
with Urg("publish", RECORDING) as urg:
    take = lambda: got.extend(reader.take(100))
    wait("the recording ends", lambda: take() or urg.process.poll() is not None, 60)
    take()
scans = [scan for scan in got if isinstance(scan, LaserScan)]
stamp = lambda scan: scan.header.stamp.sec * 1_000_000_000 + scan.header.stamp.nanosec
compare("Cyclone DDS", [(stamp(scan), list(scan.ranges)) for scan in scans])


def places_are_kept_for_late_readers():
    """With ROS's own arguments, as `ros2 run` and launch files pass them."""
    arguments = ["-r", "__node:=eyes", "-r", "__ns:=/robot", "-r", "scan:=laser/scan",
                 "-p", "frame_id:=f", "-p", "depth:=3"]
    places = ["--tf", "base,0.5,-1,2,90", "--tf", "base,0,0,0,-180"]
    scans = DataReader(participant, Topic(participant, "rt/robot/a/laser/scan", LaserScan), qos=qos)
    with Urg("publish", "a=emulated", "b=emulated", *places, "--ros-args", *arguments):
        wait("a scan", lambda: scans.take(1))
        # The places were published when the engine was opened, before the first scan.
        kept = Qos(
            Policy.Reliability.Reliable(duration(seconds=1)),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(10),
        )
        late = DataReader(participant, Topic(participant, "rt/tf_static", TFMessage), qos=kept)
        received = []
        wait("the places", lambda: received.extend(late.take(10)) or received)
        # The message is sent again at intervals, and a busy reader may find both.
        message = received[0]
        assert all(other == message for other in received), received
        left, right = message.transforms
        assert (left.header.frame_id, left.child_frame_id) == ("base", "a_f"), left
        assert (right.header.frame_id, right.child_frame_id) == ("base", "b_f"), right
        place = left.transform.translation
        assert (place.x, place.y, place.z) == (0.5, -1.0, 2.0), place
        turn = left.transform.rotation
        half = math.sqrt(0.5)
        assert all(map(math.isclose, (turn.x, turn.y, turn.z, turn.w), (0, 0, half, half))), turn
        assert math.isclose(right.transform.rotation.z, -1), right
    ok("places are kept for readers that come late; ROS's own arguments are followed")


places_are_kept_for_late_readers()
os._exit(0)
