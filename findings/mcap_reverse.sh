#!/usr/bin/env bash
# mcap 1.6.0 (PyPI) reads a file without chunks forwards although it is asked for `reverse=True`.
#
# Chunks are optional. Expected: the newest message first, or an error that says that this file cannot
# be read backwards, as its documentation of `reverse` names no condition.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import PLACE, compare, pypi

pypi("mcap==1.6.0")
from mcap.reader import make_reader  # noqa: E402
from mcap_files import chunked, unchunked  # noqa: E402


def backwards(data):
    path = PLACE / "file.mcap"
    path.write_bytes(data)
    with path.open("rb") as file:
        return [message.sequence for _, _, message in make_reader(file).iter_messages(reverse=True)]


seen = {"with chunks": backwards(chunked()), "without": backwards(unchunked())}
compare(seen, {"with chunks": [3, 2, 1, 0], "without": [0, 1, 2, 3]})
END
