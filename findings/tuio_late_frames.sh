#!/usr/bin/env bash
# tuio-client 0.1.0 (npm) drops a late frame, and applies it with the next one.
#
# UDP may swap packets, and frames have numbers for that. Expected: as if the late frame had not come. Its cursors
# are kept, so a cursor that rests goes back to where it was. A tracker that restarts within its first 100 frames
# counts from 1 again: all its frames are late until it reaches the old number, and then one touch is added once for
# each of them, and removed once.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import compare
from tuio_client import events
from tuio_frames import messages

swapped = [messages(1, {7: 0.125}), messages(3, {7: 0.375}), messages(2, {7: 0.25}), messages(4, {7: None})]
first_run = [messages(number, {}) for number in range(1, 7)]
second_run = [messages(number, {1: number / 16}) for number in range(1, 8)]
seen = {
    "a late frame": events(swapped),
    "a restart": events([*first_run, *second_run, messages(8, {})]),
}
compare(seen, {
    "a late frame": [("add", 7, 0.125), ("update", 7, 0.375), ("update", 7, 0.25)],
    "a restart": [
        *[("add", 1, number / 16) for number in range(1, 7)],
        ("update", 1, 0.4375),
        ("remove", 1, 0.4375),
    ],
})
END
