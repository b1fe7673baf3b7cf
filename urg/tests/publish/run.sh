#!/usr/bin/env bash
# Publishes to readers that others wrote: tests/publish/run.sh PROGRAM [core]. See the README
# beside it. `core` is what CI runs: the half that takes five minutes.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
if [ -z "${URG_IN_NAMESPACE:-}" ]; then
    exec bash "$here/peers.sh" bash "$here/run.sh" "$program" "${@:2}"
fi

place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
"$program" record emulated "$place/run.mcap" --count 60
"$program" stream "$place/run.mcap" --rate max >"$place/run.ndjson"
readers=("jazzy cyclone" "jazzy zenoh_peers" "jazzy launch" "jazzy dds" "kilted dds")
readers+=("jazzy slow_network" "jazzy discovery")
if [ "${2-}" != core ]; then
    readers+=("kilted discovery" "jazzy interfaces" "jazzy networks")
fi
for reader in "${readers[@]}"; do
    read -r venv script <<<"$reader"
    echo "$script ($venv)"
    if [ "${2-}" != core ]; then
        timeout 240 "$URG_PEERS/$venv/bin/python" "$here/$script.py" "$program" "$place/run.mcap"
        continue
    fi
    # A reader can hang (README). A defect of ours fails three times; each time has
    # processes of its own, which end with it.
    for try in 1 2 3; do
        if timeout 240 unshare -pf --mount-proc --kill-child \
            "$URG_PEERS/$venv/bin/python" "$here/$script.py" "$program" "$place/run.mcap" core; then
            break
        fi
        [ "$try" != 3 ] || exit 1
        echo "failed $try times"
    done
done
[ "${2-}" != core ] || exit 0
echo "hundred_sensors"
for engine in dds zenoh; do
    timeout 180 "$URG_PEERS/jazzy/bin/python" "$here/hundred_sensors.py" "$program" "$place/run.mcap" "$engine"
done
# Without a reader's own Python: it sets what other programs would inherit.
echo "outages"
timeout 120 "$URG_PYTHON" "$here/outages.py" "$program" "$place/run.mcap" dds 5
# Stopped for a moment, and the smallest depth.
timeout 120 "$URG_PYTHON" "$here/outages.py" "$program" "$place/run.mcap" zenoh
