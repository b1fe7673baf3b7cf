"""A program that writes texts with Cyclone DDS."""


def cyclone_writer(domain, topic, type_name):
    """Each call of its `write()` writes one text."""
    return f"""
from dataclasses import dataclass
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
@dataclass
class Text(IdlStruct, typename="{type_name}"):
    data: str
cdr = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
qos = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(1), cdr)
participant = DomainParticipant({domain})
writer = DataWriter(participant, Topic(participant, "{topic}", Text), qos=qos)
def write(): writer.write(Text("hello"))
"""
