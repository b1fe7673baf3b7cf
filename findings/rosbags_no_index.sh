#!/usr/bin/env bash
# rosbags 0.11.9 (PyPI) yields no message of a chunk without a message index, and no error.
#
# The index is optional: an empty map in the chunk's index says that there is none. Expected: the
# messages, by reading the chunk, or an error. `message_count` counts them all the same.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import PLACE, compare, pypi

pypi("rosbags==0.11.9")
from mcap_files import chunked  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402


def counts(data):
    path = PLACE / "file.mcap"
    path.write_bytes(data)
    with Reader(path) as reader:
        return reader.message_count, len(list(reader.messages()))


seen = {"indexed": counts(chunked()), "not indexed": counts(chunked(is_indexed=False))}
compare(seen, {"indexed": (4, 4), "not indexed": (4, 0)})
END
