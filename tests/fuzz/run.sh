#!/usr/bin/env bash
# Builds the fuzz targets for speed, and runs them:
#
#   tests/fuzz/run.sh TARGET [CORPUS] [libFuzzer's options]
#   tests/fuzz/run.sh --all [TIMES [SEED]]   each target, from no corpus, with one seed and
#                                       TIMES its number of executions: so a change fails it, and
#                                       not chance
#
# cargo-fuzz instruments every crate. Here only this one, its targets and the reader of
# recordings are: tokio's branches are no news, and libFuzzer looks at all counters after
# each execution. Comparisons are not recorded, and there is no address sanitizer, because
# this crate forbids unsafe code. Debug assertions and overflow checks are on.
set -euo pipefail
cd "$(dirname "$0")"

# The greatest length of an input, beyond which each target only repeats itself.
declare -A longest=(
    [codec]=100 [reply]=100 [scip2]=300 [version]=160 [emulator]=100 [recording]=200 [part]=60 [driver]=64
)
# The number of executions of each target with --all: about eight seconds.
declare -A executions=(
    [codec]=700000 [reply]=700000 [scip2]=300000 [version]=500000 [emulator]=150000
    [recording]=150000 [part]=40000 [driver]=50000
)
if [ "${1-}" != --all ] && [ -z "${longest[${1-none}]-}" ]; then
    sed -n '2,/^set/s/^# \{0,1\}//p' run.sh >&2
    exit 2
fi

export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/../../target/fuzz}
flags='["-Cpasses=sancov-module","-Cllvm-args=-sanitizer-coverage-level=4"'
flags+=',"-Cllvm-args=-sanitizer-coverage-inline-8bit-counters"'
flags+=',"-Cllvm-args=-sanitizer-coverage-pc-table"]'
options=(--release --locked -Zprofile-rustflags)
for crate in tokio-scip urg-emulator urg-recording tokio-scip-fuzz mcap; do
    options+=(--config "profile.release.package.$crate.rustflags=$flags")
done
for setting in debug-assertions=true overflow-checks=true codegen-units=1; do
    options+=(--config "profile.release.$setting")
done
RUSTFLAGS="--cfg fuzzing" cargo +nightly build --quiet "${options[@]}"

# Paths of a corpus are the caller's.
cd "$OLDPWD"
if [ "$1" != --all ]; then
    exec "$CARGO_TARGET_DIR/release/$1" -max_len="${longest[$1]}" "${@:2}"
fi
output=$(mktemp)
trap 'rm -f "$output"' EXIT
for target in "${!longest[@]}"; do
    # libFuzzer's last line has the number of executions.
    "$CARGO_TARGET_DIR/release/$target" -max_len="${longest[$target]}" -seed="${3:-1}" \
        -runs=$((executions[$target] * ${2:-1})) -artifact_prefix="$CARGO_TARGET_DIR/$target-" >"$output" 2>&1 ||
        { cat "$output"; exit 1; }
    echo "$target: $(grep DONE "$output")"
done
