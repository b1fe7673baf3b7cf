#!/usr/bin/env bash
# Checks that Ctrl-C ends `urg cut` and `urg repair` while a disk hangs: strace holds one of their
# calls for a minute.
#
#     urg/tests/hung_disk.sh target/debug/urg
set -euo pipefail

if ! command -v strace >/dev/null || ! strace -o /dev/null true 2>/dev/null; then
    echo "skipped: strace"
    exit 0
fi
program=$1
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"$program" record emulated "$place/run.mcap" --count 5 2>/dev/null
head -c -30 "$place/run.mcap" >"$place/cut.mcap"

# Holds these calls on this file, and fails if the command runs for two seconds after Ctrl-C.
hold() {
    local calls=$1 file=$2 child tracer
    shift 2
    rm -f "$place"/{out.mcap*,log}
    strace -f -qq -o "$place/log" -P "$file" -e trace="$calls" -e inject="$calls:delay_enter=60s" \
        "$program" "$@" "$place/out.mcap" 2>"$place/notices" &
    tracer=$!
    # The call has begun once strace logs it.
    until [ -s "$place/log" ]; do sleep 0.05; done
    child=$(pgrep -P "$tracer")
    kill -INT "$child"
    for _ in {1..40}; do
        # A zombie, until strace lets the call go.
        if ! grep -q '^State:.[^ZX]' "/proc/$child/status" 2>/dev/null; then
            echo "$1, $calls: $(grep ^urg: "$place/notices")"
            kill -KILL "$tracer"
            wait "$tracer" 2>/dev/null || true
            return
        fi
        sleep 0.05
    done
    echo "$1 still waits for $calls on $file"
    kill -KILL "$child" "$tracer"
    return 1
}

hold statx "$place/out.mcap" cut "$place/run.mcap"
hold openat "$place/run.mcap" cut "$place/run.mcap"
hold read "$place/run.mcap" cut "$place/run.mcap"
hold fsync "$place" cut "$place/run.mcap"
hold fsync "$place" repair "$place/cut.mcap"
