#!/usr/bin/env bash
# @mcap/core 2.2.2 (npm) cannot open a file whose "data end" record has grown.
#
# The format lets a record have new fields at its end, which readers skip. Expected: the messages, as
# with every other record that has grown. It reads the record as if its length were fixed, and takes
# bytes of it for the length of another record. The Python packages mcap and rosbags read the file.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from mcap_core import read
from mcap_files import chunked
from place import compare

seen = {"as usual": read(chunked()), "grown by 6 bytes": read(chunked(grown_end=b"\1\2\3\4\5\6"))}
too_large = "Record content length 144396663052566528 is too large"
compare(seen, {"as usual": [4, [0, 1, 2, 3]], "grown by 6 bytes": too_large})
END
