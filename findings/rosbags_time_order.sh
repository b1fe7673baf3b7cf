#!/usr/bin/env bash
# rosbags 0.11.9 (PyPI) cannot read a file without chunks whose messages are not in the order of time.
#
# The format asks for no order, and with chunks rosbags sorts. Expected: the same messages, sorted or
# as they are written, since a recorder writes what arrives late when it arrives.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import PLACE, compare, pypi

pypi("rosbags==0.11.9")
from mcap_files import chunked, unchunked  # noqa: E402
from rosbags.rosbag2 import Reader, ReaderError  # noqa: E402


def times(data):
    path = PLACE / "file.mcap"
    path.write_bytes(data)
    try:
        with Reader(path) as reader:
            return [time // 10**9 % 10 for _, time, _ in reader.messages()]
    except ReaderError as error:
        return str(error)


order = [0, 2, 1, 3]
seen = {"with chunks": times(chunked(order=order)), "without": times(unchunked(order=order))}
refused = "Unindexed MCAP messages are not in timestamp order. Use an indexed file."
compare(seen, {"with chunks": [0, 1, 2, 3], "without": refused})
END
