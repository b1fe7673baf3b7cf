#!/usr/bin/env bash
# Measures an idle link over TCP: first the bytes and the CPU time of keepalive and idle
# probe in ten minutes each, then the time until a server that disappears without a word
# is noticed. The server is `urg emulate` in a network namespace; it disappears when all
# that it sends is dropped there (a blackhole route), and comes back after 60 s.
#
#   cargo build --release -p urg && bash benches/idle.sh target/release/urg
#
# Needs root and iproute2 (Linux). SECONDS_IDLE=60 shortens the first part.
set -euo pipefail
urg=$(realpath "$1") idle=${SECONDS_IDLE:-600}
cd "$(dirname "$0")/.."
cargo build --release --bench idle 2>/dev/null
bench=$(cargo build --release --bench idle --message-format=json 2>/dev/null |
    sed -n 's/.*"executable":"\([^"]*idle-[^"]*\)".*/\1/p')

space=urg-idle-$$ near=uri$$a far=uri$$b
ip netns add "$space"
trap 'kill %1 2>/dev/null || true; ip netns delete "$space"' EXIT
ip link add "$near" type veth peer name "$far" netns "$space"
ip addr add 10.99.7.1/24 dev "$near"
ip link set "$near" up
ip -n "$space" addr add 10.99.7.2/24 dev "$far"
ip -n "$space" link set "$far" up
ip netns exec "$space" "$urg" emulate --tcp 10.99.7.2:4000 2>/dev/null &
sleep 2

# Bytes and packets of both directions, Ethernet frames without their checksum.
traffic() {
    (cd "/sys/class/net/$near/statistics" &&
        echo "$(cat tx_bytes) $(cat rx_bytes) $(cat tx_packets) $(cat rx_packets)")
}

for mode in keepalive probe; do
    before=($(traffic))
    echo "== $mode, idle for $idle s"
    "$bench" tcp://10.99.7.2:4000 "$mode" "$idle"
    after=($(traffic))
    echo "sent $((after[0] - before[0])) bytes in $((after[2] - before[2])) packets," \
        "received $((after[1] - before[1])) bytes in $((after[3] - before[3])) packets"
done

for mode in polls probe keepalive; do
    echo "== $mode, the server disappears after 12.3 s, and is back after 72.3 s"
    "$bench" tcp://10.99.7.2:4000 "$mode" 120 &
    watcher=$!
    sleep 12.3
    ip -n "$space" route add blackhole 10.99.7.1/32
    sleep 60
    ip -n "$space" route delete blackhole 10.99.7.1/32
    wait "$watcher"
done
