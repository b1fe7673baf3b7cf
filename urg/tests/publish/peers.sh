#!/usr/bin/env bash
# Installs the readers that others wrote, and runs a command in a network namespace of
# its own: tests/publish/peers.sh COMMAND... The readers are in $URG_PEERS/jazzy and
# $URG_PEERS/kilted, or else in a folder that is removed. A line that begins with
# `skipped:` says what this machine has not.
set -euo pipefail

if [ -n "${URG_IN_NAMESPACE:-}" ]; then
    # Fast DDS keeps locks and ports in shared memory, under names that two networks have in
    # common, and leaves those of a killed program there.
    mount -t tmpfs none /dev/shm
    ip link set lo up
    ip link set lo multicast on
    ip route add 224.0.0.0/4 dev lo
    # Some programs ask whether there is a network.
    ip addr add 10.77.0.1/32 dev lo
    place=$(mktemp -d)
    trap 'rm -rf "$place"' EXIT
    # What the readers leave behind goes with the folder.
    export ROS_DOMAIN_ID=7 RMW_IMPLEMENTATION=rmw_fastrtps_cpp ROS_LOG_DIR="$place"
    export PYTHONDONTWRITEBYTECODE=1
    "$@"
    exit
fi

skip() {
    echo "skipped: $1"
    exit 0
}

# The readers are built for 3.11; another one finds no packages, and pip says so.
URG_PYTHON=$(command -v python3.11 || command -v python3) ||
    skip "Python 3.11, for the readers of urg publish"
"$URG_PYTHON" -m venv --help >/dev/null 2>&1 ||
    skip "Python's venv, for the readers of urg publish"
export URG_PYTHON
unshare -rn true 2>/dev/null || skip "network namespaces, for the readers of urg publish"
if [ -z "${URG_PEERS:-}" ]; then
    URG_PEERS=$(mktemp -d)
    trap 'rm -rf "$URG_PEERS"' EXIT
fi
export URG_PEERS

install() {
    local venv=$URG_PEERS/$1
    shift
    [ -e "$venv/installed" ] && return
    "$URG_PYTHON" -m venv "$venv" && "$venv/bin/pip" install --quiet "$@" && touch "$venv/installed"
}
install jazzy ros-jazzy-rclpy==7.1.6 ros-jazzy-sensor-msgs==5.3.6 \
    ros-jazzy-diagnostic-msgs==5.3.6 ros-jazzy-rmw-fastrtps-cpp==8.4.3 \
    cyclonedds==11.0.1 eclipse-zenoh==1.10.2 pyzeros==0.1.0 || skip "the readers of urg publish"
install kilted ros-kilted-rclpy==9.1.2 ros-kilted-sensor-msgs==5.5.1 \
    ros-kilted-diagnostic-msgs==5.5.1 ros-kilted-rmw-fastrtps-cpp==9.3.3 ||
    skip "the readers of urg publish"
# Of processes, too: nothing outlives a failed test.
URG_IN_NAMESPACE=1 unshare -rnpf --mount-proc --kill-child bash "$0" "$@"
