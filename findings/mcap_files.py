"""Writes MCAP records, after the format's text, where writers would not: see the other scripts."""

import struct
import zlib

MAGIC = b"\x89MCAP0\r\n"
FIRST = 1_700_000_000_000_000_000
QUARTET = range(4)


def text(value):
    value = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(value)) + value


def record(kind, body):
    return bytes([kind]) + struct.pack("<Q", len(body)) + body


def schema(end=b""):
    body = struct.pack("<H", 1) + text("std_msgs/msg/String") + text("ros2msg") + text("string data\n")
    return record(3, body + end)


def channel(end=b""):
    qos = text("offered_qos_profiles") + text("")
    return record(4, struct.pack("<HH", 1, 1) + text("/chatter") + text("cdr") + text(qos) + end)


def time_of(number):
    return FIRST + number * 1_000_000_000


def message(number, published=None):
    times = time_of(number), time_of(number if published is None else published)
    return record(5, struct.pack("<HIQQ", 1, number, *times) + b"\0\1\0\0" + text(b"a\0"))


def data_end(grown=b""):
    return record(15, struct.pack("<I", 0) + grown)


def statistics(chunks):
    counts = struct.pack("<IHQ", 10, 1, len(QUARTET))
    body = struct.pack("<QHIIIIQQ", len(QUARTET), 1, 1, 0, 0, chunks, time_of(0), time_of(3))
    return record(11, body + counts)


def file(data, summary):
    """A file with its summary, which begins after the data."""
    start = MAGIC + record(1, text("ros2") + text("findings")) + data
    footer = record(2, struct.pack("<QQI", len(start), 0, 0))
    return start + summary + footer + MAGIC


def unchunked(grown_end=b"", order=QUARTET, schema_end=b"", channel_end=b""):
    """Four messages, one each second, with a summary but no chunks."""
    before = schema(schema_end) + channel(channel_end)
    data = before + b"".join(map(message, order)) + data_end(grown_end)
    return file(data, before + statistics(0))


def chunked(grown_end=b"", is_indexed=True, is_reversed=False, order=QUARTET, schema_end=b"", channel_end=b""):
    """The same in one chunk, with or without an index, published in this order or the reverse."""
    before = schema(schema_end) + channel(channel_end)
    inner, entries = before, b""
    for number in order:
        entries += struct.pack("<QQ", time_of(number), len(inner))
        inner += message(number, 3 - number if is_reversed else number)
    times = struct.pack("<QQ", time_of(0), time_of(3))
    sizes = struct.pack("<QI", len(inner), zlib.crc32(inner))
    chunk = record(6, times + sizes + text("") + struct.pack("<Q", len(inner)) + inner)
    index = record(7, struct.pack("<H", 1) + text(entries)) if is_indexed else b""
    at = len(MAGIC) + len(record(1, text("ros2") + text("findings")))
    offsets = struct.pack("<HQ", 1, at + len(chunk)) if is_indexed else b""
    chunk_index = times + struct.pack("<QQ", at, len(chunk)) + text(offsets)
    chunk_index += struct.pack("<Q", len(index)) + text("") + struct.pack("<QQ", len(inner), len(inner))
    summary = before + statistics(1) + record(8, chunk_index)
    return file(chunk + index + data_end(grown_end), summary)
