#!/usr/bin/env bash
# zerodds 1.0.0rc3 (PyPI) announces each topic as one of `zerodds::RawBytes`, whatever type its program declares.
#
# Its IdlTopic takes a class with a type name, which "on the wire comes from" there. Expected: Cyclone DDS 11.0.1 (PyPI)
# finds a writer of that type, so that a ROS 2 type is possible. DDS matches names of types, so it meets no program but
# its own, and says nothing.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess
import sys
import time

from place import compare, network, pypi, run

WRITER = """
import time
from dataclasses import dataclass
import zerodds
from zerodds.idl import Int32, idl_struct

@idl_struct(typename="robot::Speed")
@dataclass
class Speed:
    value: Int32

participant = zerodds.DomainParticipantFactory.instance().create_participant(0)
topic = zerodds.IdlTopic(participant, "speed", Speed)
writer = topic.create_writer(participant.create_publisher())
print(topic.type_name, flush=True)
while True:
    writer.write(Speed(5))
    time.sleep(0.1)
"""
os.environ["PYTHONPATH"] = str(pypi("zerodds==1.0.0rc3", "cyclonedds==11.0.1"))
network()
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402

writer = run(sys.executable, "-c", WRITER, stdout=subprocess.PIPE, text=True)
declared = writer.stdout.readline().strip()
participant = DomainParticipant(0)
publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
announced = None
for _ in range(100):
    for publication in publications.take(10):
        if publication.topic_name == "speed":
            announced = publication.type_name
    if announced:
        break
    time.sleep(0.1)
compare({"declared": declared, "announced": announced}, {
    "declared": "robot::Speed",
    "announced": "zerodds::RawBytes",
})
END
