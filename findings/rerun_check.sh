#!/usr/bin/env bash
# `rerun mcap check` 0.41.0 (PyPI, rerun-sdk) exits with 0 when it finds a problem, and when it finds nothing.
#
# Messages that were published in another order than they were logged are a PROBLEM in its table. Expected:
# another exit status, as a check in a script needs one. A file without chunks, which is valid, has no row in the table: its messages are not seen.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess
import sys

from mcap_files import chunked, unchunked
from place import PLACE, compare, pypi

packages = pypi("--no-deps", "rerun-sdk==0.41.0")
# The program writes its settings into a home of its own, and sends nothing.
environment = dict(os.environ, HOME=str(PLACE), PYTHONPATH=str(packages))
rerun = [sys.executable, "-m", "rerun_cli"]
subprocess.run([*rerun, "analytics", "disable"], env=environment, capture_output=True, check=True)


def check(data):
    path = PLACE / "file.mcap"
    path.write_bytes(data)
    command = [*rerun, "mcap", "check", "--full", path]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    rows = [line.split() for line in done.stdout.splitlines()]
    return done.returncode, [row[0] for row in rows if "/chatter" in row]


seen = {
    "in order": check(chunked()),
    "out of order": check(chunked(is_reversed=True)),
    "without chunks": check(unchunked()),
}
compare(seen, {"in order": (0, ["ok"]), "out of order": (0, ["PROBLEM"]), "without chunks": (0, [])})
END
