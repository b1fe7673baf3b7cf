#!/usr/bin/env bash
# mawk 1.3.4 (`awk` of Debian 12) and Miller 6.6.0 hold the lines of a pipe, even one that says that a sensor is lost.
#
# Expected: each line of NDJSON passes at once if the filter flushes what it writes, as with jq, perl and busybox's awk.
# mawk waits until its input fills a whole number of 4,096 bytes, unless called with `-W interactive`. Miller waits for
# 500 lines, 50 s of a URG, even with `--fflush`; with `--records-per-batch 1`, too, it passes each at once.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import subprocess
import threading
import time

from place import compare, debian, run

SCAN = json.dumps({"sequence": 7, "ranges": [1.234] * 1000}) + "\n"
LOST = json.dumps({"event": "disconnected"}) + "\n"


def passed(command, *parts):
    """Returns how many lines have passed a second after each of these parts."""
    filter = run(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    lines, counts = [], []
    threading.Thread(target=lambda: lines.extend(iter(filter.stdout.readline, b"")), daemon=True).start()
    for part in parts:
        filter.stdin.write(part.encode())
        filter.stdin.flush()
        time.sleep(1)
        counts.append(len(lines))
    filter.stdin.close()
    filter.wait()
    return counts


debian("mawk=1.3.4.20200120-3.1", "miller=6.6.0-2+b3")
mawk, awk = [SCAN, LOST, SCAN, LOST], ["{ print length($0); fflush() }"]
mlr, miller = [LOST * 499, LOST, LOST], ["mlr", "--ijsonl", "--ojsonl", "--fflush"]
compare({
    "mawk": passed(["mawk", *awk], *mawk),
    "mawk -W interactive": passed(["mawk", "-W", "interactive", *awk], *mawk),
    "mlr --fflush": passed([*miller, "cat"], *mlr),
    "mlr --fflush --records-per-batch 1": passed([*miller, "--records-per-batch", "1", "cat"], *mlr),
}, {
    "mawk": [0, 0, 2, 2],
    "mawk -W interactive": [1, 2, 3, 4],
    "mlr --fflush": [0, 500, 500],
    "mlr --fflush --records-per-batch 1": [499, 500, 501],
})
END
