#!/usr/bin/env bash
# Builds the examples for NATS and MQTT (examples/bus), and runs them against nats-server and
# mosquitto, on an emulated sensor: tests/publish/bus.sh PROGRAM. It runs in a network namespace
# of its own.
set -euo pipefail
crate=$(cd "$(dirname "$0")/../../.." && pwd)
program=$(realpath "$1")

for tool in nats-server mosquitto python3; do
    PATH=$PATH:/usr/sbin command -v "$tool" >/dev/null || { echo "skipped: $tool"; exit 0; }
done
unshare -rn true 2>/dev/null || { echo "skipped: network namespaces"; exit 0; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$work/bus/src/bin"
cat >"$work/bus/Cargo.toml" <<END
[package]
name = "bus"
version = "0.0.0"
edition = "2024"
[dependencies]
async-nats = { version = "=0.51.0", default-features = false, features = ["ring"] }
rumqttc = { version = "=0.25.1", default-features = false }
serde_json = "1"
tokio = { version = "1", features = ["rt-multi-thread", "macros"] }
tokio-scip = { path = "$crate", features = ["serde"] }
urg-recording = { path = "$crate/recording" }
# Whatever is in a folder above.
[workspace]
END
cp "$crate/Cargo.lock" "$work/bus/"
cp "$crate"/examples/bus/*.rs "$work/bus/src/bin/"
(cd "$work/bus" && cargo build --quiet)
# A namespace of processes, too: nothing outlives a failed test.
PATH=$PATH:/usr/sbin unshare -rnpf --kill-child timeout 100 python3 "$crate/urg/tests/publish/bus.py" \
    "$program" "$work/bus/target/debug" "$work"
