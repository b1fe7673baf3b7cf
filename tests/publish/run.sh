#!/usr/bin/env bash
# Publishes to readers that others wrote: tests/publish/run.sh PROGRAM. See the README
# beside it.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")
if [ -z "${URG_IN_NAMESPACE:-}" ]; then
    exec bash "$here/peers.sh" bash "$here/run.sh" "$program"
fi

place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
"$program" record emulated "$place/run.mcap" --count 60
"$program" stream "$place/run.mcap" --rate max >"$place/run.ndjson"
for reader in "jazzy dds" "kilted dds" "jazzy cyclone" "jazzy zenoh_peers" "jazzy networks" "jazzy slow_network"; do
    read -r venv script <<<"$reader"
    echo "$script ($venv)"
    timeout 240 "$URG_PEERS/$venv/bin/python" "$here/$script.py" "$program" "$place/run.mcap"
done
