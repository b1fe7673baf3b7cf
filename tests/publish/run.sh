#!/usr/bin/env bash
# Publishes to readers that others wrote: tests/publish/run.sh PROGRAM. See the README
# beside it. A line that begins with `skipped:` says what this machine has not.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=$(realpath "$1")

skip() {
    echo "skipped: $1"
    exit 0
}

if [ -z "${URG_IN_NAMESPACE:-}" ]; then
    python=$(command -v python3.11) || skip "Python 3.11, for the readers of urg publish"
    unshare -rn true 2>/dev/null || skip "network namespaces, for the readers of urg publish"
    peers=${URG_PEERS:-}
    if [ -z "$peers" ]; then
        peers=$(mktemp -d)
        trap 'rm -rf "$peers"' EXIT
    fi
    install() {
        local venv=$peers/$1
        shift
        [ -x "$venv/bin/python" ] && return
        "$python" -m venv "$venv" && "$venv/bin/pip" install --quiet "$@"
    }
    install jazzy ros-jazzy-rclpy==7.1.6 ros-jazzy-sensor-msgs==5.3.6 \
        ros-jazzy-diagnostic-msgs==5.3.6 ros-jazzy-rmw-fastrtps-cpp==8.4.3 \
        cyclonedds==11.0.1 eclipse-zenoh==1.10.2 pyzeros==0.1.0 || skip "the readers of urg publish"
    install kilted ros-kilted-rclpy==9.1.2 ros-kilted-sensor-msgs==5.5.1 \
        ros-kilted-diagnostic-msgs==5.5.1 ros-kilted-rmw-fastrtps-cpp==9.3.3 ||
        skip "the readers of urg publish"
    URG_IN_NAMESPACE=$peers unshare -rn bash "$here/run.sh" "$program"
    exit
fi

peers=$URG_IN_NAMESPACE
ip link set lo up
ip link set lo multicast on
ip route add 224.0.0.0/4 dev lo
export ROS_DOMAIN_ID=7 RMW_IMPLEMENTATION=rmw_fastrtps_cpp ROS_LOG_DIR
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
ROS_LOG_DIR=$place/log
# What the readers leave behind goes with the folder.
export PYTHONDONTWRITEBYTECODE=1
cd "$place"
"$program" record emulated "$place/run.mcap" --count 60
"$program" stream "$place/run.mcap" --rate max >"$place/run.ndjson"
for reader in "jazzy dds" "kilted dds" "jazzy cyclone" "jazzy zenoh_peers"; do
    read -r venv script <<<"$reader"
    echo "$script ($venv)"
    timeout 120 "$peers/$venv/bin/python" "$here/$script.py" "$program" "$place/run.mcap"
done
