"""Reads files of random histories (`recording/tests/histories`) with readers that others wrote, and
compares each message with what the test found.

    cargo test -p urg-recording histories
    pip install mcap-ros2-support rosbags
    python3 urg/tests/recording_histories.py target/tmp/histories
"""

import sys
import zlib
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader


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


main()
