#!/usr/bin/env bash
# @mcap/core 2.2.2 (npm): McapIndexedReader opens a file without chunks and yields no message.
#
# The file is valid and has a summary, whose statistics say 4 messages. Expected: the messages, or the
# error "File is not indexed" that a file without a summary gets.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from mcap_core import read
from mcap_files import chunked, unchunked
from place import compare

seen = {"with chunks": read(chunked()), "without": read(unchunked())}
compare(seen, {"with chunks": [4, [0, 1, 2, 3]], "without": [4, []]})
END
