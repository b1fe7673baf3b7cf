"""Prints how many scans two readers that others wrote find in each recording, as one line of
JSON: readers.py FILE.mcap…"""

import json
import pathlib
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader


def with_mcap(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return sum(channel.topic == "/scan" for _, channel, _, _ in reader.iter_decoded_messages())


def with_rosbags(path):
    with Reader(path) as reader:
        return sum(connection.topic == "/scan" for connection, _, _ in reader.messages())


paths = [pathlib.Path(name) for name in sys.argv[1:]]
print(json.dumps({str(path): [with_mcap(path), with_rosbags(path)] for path in paths}))
