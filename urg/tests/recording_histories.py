"""Reads files of random histories (`recording/tests/histories`) with readers that others wrote, and
compares each message with what the test found.

    cargo test -p urg-recording histories
    pip install mcap-ros2-support rosbags
    python3 urg/tests/recording_histories.py target/tmp/histories target/debug/urg

Also joins them with bags that rosbags writes, in any order, and cuts the copy off and repairs it.
"""

import io
import math
import random
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import mcap.stream_reader
import numpy as np
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Footer
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
HEADER, PLACED, PLACE, SCAN, STRING, TF, TIME, TURN, VECTOR = (STORE.types[name] for name in (
    "std_msgs/msg/Header", "geometry_msgs/msg/TransformStamped", "geometry_msgs/msg/Transform",
    "sensor_msgs/msg/LaserScan", "std_msgs/msg/String", "tf2_msgs/msg/TFMessage",
    "builtin_interfaces/msg/Time", "geometry_msgs/msg/Quaternion", "geometry_msgs/msg/Vector3"))
BEGAN = 1_700_000_000_000_000_000
TOPICS = ["/scan", "/front/scan", "/chatter", "/scip/events"]
TYPES = ["sensor_msgs/msg/LaserScan", "std_msgs/msg/String", "std_msgs/msg/UInt8MultiArray"]


def truth(path):
    lines = (line.split(" ") for line in path.with_suffix(".txt").read_text().splitlines())
    return sorted((topic, int(time), int(checksum)) for topic, time, checksum in lines)


def summary_of(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary()


def is_for_rosbags(path):
    """It reads bags of ROS 2 alone, with an index, and those without chunks only in the order of
    their times."""
    summary = summary_of(path)
    with path.open("rb") as file:
        reader = make_reader(file)
        if summary is None or reader.get_header().profile != "ros2":
            return False
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        return bool(summary.chunk_indexes) or times == sorted(times)


def by_mcap(path):
    summary = summary_of(path)
    with path.open("rb") as file:
        # Files of later versions have no index.
        reader = (make_reader if summary else NonSeekingReader)(file, validate_crcs=True)
        messages = list(reader.iter_messages())
        # Statistics may be missing, too.
        statistics = summary and summary.statistics
        assert not statistics or len(messages) == statistics.message_count
        assert sorted(m.log_time for _, _, m in messages) == [m.log_time for _, _, m in messages]
        return sorted((c.topic, m.log_time, zlib.crc32(m.data)) for _, c, m in messages)


def with_new_fields(chunk, validate_crc=False):
    """Reads the records of a chunk as those of a file: mcap 1.6.0 skips new fields of a schema or a
    channel only there. It decompresses no empty chunk of zstd."""
    if chunk.uncompressed_size == 0:
        return []
    data = get_chunk_data_stream(chunk, validate_crc=validate_crc)[0].read(chunk.uncompressed_size)
    end = bytes([Opcode.FOOTER, 20]) + bytes(27) + MAGIC
    records = StreamReader(io.BytesIO(data + end), skip_magic=True).records
    return [record for record in records if not isinstance(record, Footer)]


def by_rosbags(path):
    with Reader(path) as reader:
        messages = [(c.topic, time, zlib.crc32(data)) for c, time, data in reader.messages()]
        assert len(messages) == reader.message_count
        return sorted(messages)


def topics_of(path):
    return {channel.topic for channel in summary_of(path).channels.values()}


def latched(path):
    """Writes two maps, the place of two frames and ten texts, one a second, as rosbags does. The
    topic /never has no message."""
    def offered(durability):
        time = QosTime(2**31 - 1, 2**32 - 1)
        return [Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, durability, time, time,
                    QosLiveliness.AUTOMATIC, time, False)]

    version = 8 + len(path.name) % 2
    with Writer(path, version=version, storage_plugin=StoragePlugin.MCAP) as bag:
        add = lambda topic, kind, durability: bag.add_connection(
            topic, kind, typestore=STORE, offered_qos_profiles=offered(durability))
        volatile, kept = QosDurability.VOLATILE, QosDurability.TRANSIENT_LOCAL
        places = add("/tf_static", "tf2_msgs/msg/TFMessage", kept)
        maps, texts = add("/map", "std_msgs/msg/String", kept), add("/text", "std_msgs/msg/String", volatile)
        add("/never", "std_msgs/msg/Empty", volatile)
        text = lambda number: STORE.serialize_cdr(STRING(str(number)), "std_msgs/msg/String")
        for second, child in enumerate(["left", "right", "left"]):
            time = TIME(second, 0)
            place = PLACED(HEADER(time, "base"), child, PLACE(VECTOR(second, 0, 0), TURN(0, 0, 0, 1)))
            bag.write(places, BEGAN + second, STORE.serialize_cdr(TF([place]), "tf2_msgs/msg/TFMessage"))
        for number in range(2):
            bag.write(maps, BEGAN + 10 + number, text(number))
        # The part counts from the first scan.
        scans = add("/scan", "sensor_msgs/msg/LaserScan", volatile)
        bag.write(scans, BEGAN + 20, scan())
        for second in range(1, 10):
            bag.write(texts, BEGAN + second * 10**9, text(second))


def scan():
    step = 2 * math.pi / 1024
    ranges = np.ones(5, dtype=np.float32)
    made = SCAN(HEADER(TIME(1, 0), "laser"), 0.0, 4 * step, step, 0.0001, 0.1, 0.02, 4.095, ranges, ranges[:0])
    return STORE.serialize_cdr(made, "sensor_msgs/msg/LaserScan")


def cut_latched(program, folder):
    """Cuts 5 s to 7 s out of a folder of rosbags, and reads what the part begins with."""
    for version in ("bag", "bags"):
        latched(folder / version)
        part = folder / f"{version}.mcap"
        subprocess.run([program, "cut", folder / version, part, "--range", "4.5s..6.5s"], check=True, capture_output=True)
        with part.open("rb") as file:
            found = [(c.topic, m.data) for _, c, m in make_reader(file).iter_messages()]
        text = lambda data: STORE.deserialize_cdr(data, "std_msgs/msg/String").data
        frames = [STORE.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms[0]
                  for topic, data in found if topic == "/tf_static"]
        placed = {place.child_frame_id: place.transform.translation.x for place in frames}
        assert placed == {"left": 2, "right": 1} and len(frames) == 2, placed
        assert [text(data) for topic, data in found if topic == "/map"] == ["1"], found
        assert [text(data) for topic, data in found if topic == "/text"] == ["5", "6"], found
        assert topics_of(part) == {"/tf_static", "/map", "/text", "/never", "/scan"}, topics_of(part)
        with Reader(part) as reader:
            assert {c.topic: c.msgcount for c in reader.connections}["/never"] == 0
    told = subprocess.run([program, "info", folder / "bag"], check=True, capture_output=True, text=True).stdout
    assert "scans          1" in told, told


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
    return path, expected


def join(program, recordings, folder, chance):
    """Joins a recording and the folders of two bags of rosbags. Returns the number of messages."""
    bags = [write_bag(folder / name, chance) for name in ("one", "two")]
    recording = chance.choice(recordings)
    inputs = [recording, *(path for path, _ in bags)]
    chance.shuffle(inputs)
    joined, repaired = folder / "joined.mcap", folder / "repaired.mcap"
    run = lambda *words: subprocess.run([program, *words], check=True, capture_output=True)
    run("cut", *inputs, joined)
    expected = sorted(truth(recording) + [message for _, bag in bags for message in bag])
    readers = [by_mcap, by_rosbags] if is_for_rosbags(joined) else [by_mcap]
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
    mcap.stream_reader.breakup_chunk = with_new_fields
    counts = {by_mcap: 0, by_rosbags: 0}
    paths = sorted(Path(sys.argv[1]).glob("*.mcap"))
    later = sum(summary_of(path) is None for path in paths)
    for path in paths:
        expected = truth(path)
        for read in counts:
            if read is by_rosbags and not is_for_rosbags(path):
                continue
            found = read(path)
            assert found == expected, f"{path}: {read.__name__} has {len(found)} of {len(expected)}"
            counts[read] += len(expected)
    assert later and all(counts.values()), counts
    print(f"{len(paths)} files, {later} of a later version of the format")
    print(", ".join(f"{read.__name__}: {count} messages" for read, count in counts.items()))
    recordings = [path for path in paths if truth(path)]
    joined = 0
    for seed in range(40):
        with tempfile.TemporaryDirectory() as folder:
            joined += join(sys.argv[2], recordings, Path(folder), random.Random(seed))
    print(f"joined with bags of rosbags: {joined} messages")
    with tempfile.TemporaryDirectory() as folder:
        cut_latched(sys.argv[2], Path(folder))
    print("a part begins with what was latched before it")


main()
