#!/usr/bin/env bash
# mcap 1.6.0 (PyPI) skips new fields at the end of a channel or a schema, but not inside a chunk.
#
# The format lets later versions add fields to records, which readers must skip. Expected: the four
# messages from each file, wherever the grown record lies. From a chunk come none, and no error.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import io

from place import compare, pypi

pypi("mcap==1.6.0")
from mcap.reader import make_reader  # noqa: E402
from mcap_files import chunked, unchunked  # noqa: E402


def count(data):
    return len(list(make_reader(io.BytesIO(data)).iter_messages()))


grown = {"as today": {}, "channel": {"channel_end": b"new"}, "schema": {"schema_end": b"new"}}
seen = {what: (count(unchunked(**end)), count(chunked(**end))) for what, end in grown.items()}
print("messages without chunks, and in a chunk, by what has grown:")
compare(seen, {"as today": (4, 4), "channel": (4, 0), "schema": (4, 0)})
END
