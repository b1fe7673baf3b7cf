"""Reads files of random histories (`recording/tests/histories`) with readers that others wrote, and
compares each message with what the test found.

    cargo test -p urg-recording histories
    pip install mcap-ros2-support rosbags
    python3 urg/tests/recording_histories.py target/tmp/histories target/debug/urg

Also joins them with bags that rosbags writes, in any order, and cuts the copy off and repairs it.
"""

import random
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TOPICS = ["/scan", "/front/scan", "/chatter", "/scip/events"]
TYPES = ["sensor_msgs/msg/LaserScan", "std_msgs/msg/String", "std_msgs/msg/UInt8MultiArray"]


def truth(path):
    lines = (line.split(" ") for line in path.with_suffix(".txt").read_text().splitlines())
    return sorted((topic, int(time), int(checksum)) for topic, time, checksum in lines)


def profile(path):
    with path.open("rb") as file:
        return make_reader(file).get_header().profile


def by_mcap(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = list(reader.iter_messages())
        assert len(messages) == reader.get_summary().statistics.message_count
        assert sorted(m.log_time for _, _, m in messages) == [m.log_time for _, _, m in messages]
        return sorted((c.topic, m.log_time, zlib.crc32(m.data)) for _, c, m in messages)


def by_rosbags(path):
    with Reader(path) as reader:
        messages = [(c.topic, time, zlib.crc32(data)) for c, time, data in reader.messages()]
        assert len(messages) == reader.message_count
        return sorted(messages)


def write_bag(path, chance):
    """Writes messages of any bytes on some topics, in a folder as rosbags does."""
    expected, time = [], 1_700_000_000_000_000_000 + chance.randrange(10**10)
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = chance.sample(TOPICS, chance.randint(1, 3))
        connections = [
            bag.add_connection(topic, chance.choice(TYPES), typestore=STORE) for topic in topics
        ]
        for _ in range(chance.randrange(50)):
            connection, data = chance.choice(connections), chance.randbytes(chance.randrange(99))
            bag.write(connection, time, data)
            expected.append((connection.topic, time, zlib.crc32(data)))
            time += chance.randrange(10**9)
    return path / f"{path.name}.mcap", expected


def join(program, recordings, folder, chance):
    """Joins a recording and two bags of rosbags. Returns the number of messages."""
    bags = [write_bag(folder / name, chance) for name in ("one", "two")]
    recording = chance.choice(recordings)
    inputs = [recording, *(path for path, _ in bags)]
    chance.shuffle(inputs)
    joined, repaired = folder / "joined.mcap", folder / "repaired.mcap"
    run = lambda *words: subprocess.run([program, *words], check=True, capture_output=True)
    run("cut", *inputs, joined)
    expected = sorted(truth(recording) + [message for _, bag in bags for message in bag])
    readers = [by_mcap] if profile(joined) != "ros2" else [by_mcap, by_rosbags]
    for read in readers:
        assert read(joined) == expected, f"{inputs}: {read.__name__} has others"
    # Cut off within its summary, and then anywhere in its second half.
    whole = joined.read_bytes()
    for length in (len(whole) - 9, chance.randrange(len(whole) // 2, len(whole) - 9)):
        joined.write_bytes(whole[:length])
        repaired.unlink(missing_ok=True)
        run("repair", joined, repaired)
        found = by_mcap(repaired)
        assert set(found) <= set(expected), f"{inputs}: repair has invented messages"
        assert found == expected or length < len(whole) - 9, f"{inputs}: repair has lost messages"
    return len(expected)


def main():
    counts = {by_mcap: 0, by_rosbags: 0}
    for path in sorted(Path(sys.argv[1]).glob("*.mcap")):
        expected = truth(path)
        for read in counts:
            # rosbags reads nothing else.
            if read is by_rosbags and profile(path) != "ros2":
                continue
            found = read(path)
            assert found == expected, f"{path}: {read.__name__} has {len(found)} of {len(expected)}"
            counts[read] += len(expected)
    assert all(counts.values()), counts
    print(", ".join(f"{read.__name__}: {count} messages" for read, count in counts.items()))
    recordings = [path for path in sorted(Path(sys.argv[1]).glob("*.mcap")) if truth(path)]
    joined = 0
    for seed in range(40):
        with tempfile.TemporaryDirectory() as folder:
            joined += join(sys.argv[2], recordings, Path(folder), random.Random(seed))
    print(f"joined with bags of rosbags: {joined} messages")


main()
