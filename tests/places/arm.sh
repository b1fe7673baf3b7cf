#!/usr/bin/env bash
# Runs the tests for ARM under user-mode emulation:
#   bash tests/places/arm.sh armv7|aarch64 [core | NAMES…]
# `core` is the library's own tests, protocol, codec, driver and an hour of simulation (core.txt).
# NAMES are passed to the tests. left_out.txt lists what is left out, and why.
#
# Needs on Debian: qemu-user, gcc-arm-linux-gnueabihf and libc6-dev-armhf-cross, or
# gcc-aarch64-linux-gnu and libc6-dev-arm64-cross. Without them it prints `skipped: NAME` and
# succeeds. Before QEMU 11 there are no pseudo-terminals; QEMU=FOLDER selects another one than
# PATH does.
set -euo pipefail
cd "$(dirname "$0")/../.."

case ${1-} in
armv7) target=armv7-unknown-linux-gnueabihf gnu=arm-linux-gnueabihf qemu=qemu-arm ;;
aarch64) target=aarch64-unknown-linux-gnu gnu=aarch64-linux-gnu qemu=qemu-aarch64 ;;
*) echo "usage: $0 armv7|aarch64 [core | NAMES…]" >&2 && exit 2 ;;
esac
shift
PATH=${QEMU:+$QEMU:}$PATH

for tool in "$qemu" "$gnu-gcc"; do
    command -v "$tool" || { echo "skipped: $tool" && exit 0; }
done
if [ ! -d "$(rustc --print target-libdir --target "$target")" ] && ! rustup target add "$target"; then
    echo "skipped: the std of $target" && exit 0
fi

export SCIP_SIMULATION_HOURS="${SCIP_SIMULATION_HOURS:-1}" SCIP_TEST_LIMIT_MINUTES=60
kinds=(--workspace --lib --bins --tests) names=("$@")
if [ "${1-}" = core ]; then
    kinds=(-p tokio-scip -p urg-emulator --lib --test it --test emulator)
    mapfile -t names <tests/places/core.txt
fi
version=$("$qemu" --version | sed -n '1s/.* version \([0-9]*\).*/\1/p')
places=arm
[ "$version" -ge 11 ] || places="arm|qemu-before-11"
left_out=()
while read -r _ name; do
    left_out+=(--skip "$name")
done < <(grep -E "^($places)  " tests/places/left_out.txt)

variable=CARGO_TARGET_$(tr a-z- A-Z_ <<<"$target")_LINKER
# Optimized: in the emulator that takes a fifth of the time.
messages=$(env "$variable=$gnu-gcc" cargo test --locked --no-run "${kinds[@]}" \
    --config profile.test.package.tokio-scip.opt-level=1 --target "$target" --message-format json)
built() { grep -o '"executable":"[^"]*"' <<<"$messages" | cut -d'"' -f4 | grep -E "$1"; }

# Tests start the program by its path, which the kernel cannot run: a script with its name
# starts it in the emulator.
if program=$(built '/urg$'); then
    mkdir -p "${program%/urg}/emulated"
    # Its help has the name of its file.
    mv "$program" "${program%/urg}/emulated/urg"
    printf '#!/bin/sh\nexec %s -L /usr/%s "%s" "$@"\n' "$qemu" "$gnu" "${program%/urg}/emulated/urg" >"$program"
    chmod +x "$program"
fi
failed=0
for executable in $(built '/deps/'); do
    "$qemu" -L "/usr/$gnu" "$executable" "${left_out[@]}" $([[ $executable != */@(it|emulator|recording|program)-* ]] || echo "${names[@]}") || failed=1
done
exit "$failed"
