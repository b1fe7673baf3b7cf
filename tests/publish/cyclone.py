"""Reads what `urg publish` publishes with Cyclone DDS, without ROS.

cyclone.py PROGRAM RECORDING
"""

import os
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, int32, sequence, uint32
from cyclonedds.core import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from common import RECORDING, Urg, compare, wait


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
os._exit(0)
