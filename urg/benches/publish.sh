#!/usr/bin/env bash
# Latency, CPU time and losses of `urg publish`, and bytes on the wire, with readers that
# others wrote: benches/publish.sh PROGRAM [CASE...]. It needs Python 3.11 and installs
# the readers (tests/publish/peers.sh).
set -euo pipefail
crate=$(cd "$(dirname "$0")/.." && pwd)
program=$(realpath "$1")
shift
bash "$crate/tests/publish/peers.sh" bash -c '"$URG_PEERS/jazzy/bin/python" "$@"' \
    python "$crate/benches/publish.py" "$program" "$@"
