#!/usr/bin/env bash
# socat 1.7.4.4 (Debian 12) knows 500,000 baud and neither 250,000 nor 750,000, and `ispeed` takes no speeds.
#
# Linux sets any number (termios2), as pyserial does. Expected: each speed of a serial sensor as `b250000`, or the
# rest by `ispeed=250000`. Both are errors, and so is `ispeed=115200`: it wants the number that the system's header
# gives to the constant B115200, 4098.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import subprocess

from place import compare, debian

debian("socat=1.7.4.4-2")


def error(option):
    command = ["socat", "-u", "OPEN:/dev/null", f"PTY,raw,{option}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return done.stderr.strip().partition(" E ")[2].split("(0x")[0]


options = ["b250000", "b500000", "b750000", "ispeed=115200", "ispeed=4098"]
compare({option: error(option) for option in options}, {
    "b250000": 'parseopts_table(): unknown option "b250000"',
    "b500000": "",
    "b750000": 'parseopts_table(): unknown option "b750000"',
    "ispeed=115200": "cfsetispeed",
    "ispeed=4098": "",
})
END
