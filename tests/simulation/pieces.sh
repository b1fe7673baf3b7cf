#!/usr/bin/env bash
# Runs the simulation in pieces, one on each processor, and adds them up.
#
#   tests/simulation/pieces.sh run FILE FIRST PIECES   run PIECES pieces from seed FIRST
#   tests/simulation/pieces.sh sum FILE                add up the pieces in FILE
#
# A piece is 2,500 seeds, about 98 sensor-hours. It appends one line of figures to FILE,
# and is skipped if FILE has it already, so that an interrupted run can be continued. Runs
# can share a file. The first piece that fails ends the run with the output of the test.
#
# Debug assertions and overflow checks are on, in tokio as well, and link-time optimisation,
# which takes a minute or two more to build and a quarter off each piece. SCIP_SIMULATION_PROGRAM
# names a test executable that is built already.
set -euo pipefail
seeds=2500

build() {
    CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS=true CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS=true \
        CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target/simulation} \
        cargo test --locked --release --no-default-features --test models --no-run \
        --message-format json | grep -o '"executable":"[^"]*/models-[^"]*"' | tail -n 1 | cut -d'"' -f4
}

# Prints the line of the piece that begins with seed $1, with the CPU seconds it took.
piece() {
    local output seconds
    output=$(mktemp)
    TIMEFORMAT=%U
    if ! seconds=$({ time SCIP_SIMULATION_FIRST=$1 SCIP_SIMULATION_SEEDS=$seeds \
        "$SCIP_SIMULATION_PROGRAM" simulation::seeds --nocapture >"$output" 2>&1; } 2>&1); then
        cat "$output" >&2
        return 1
    fi
    grep '^piece ' "$output" | sed "s/$/ seconds $seconds/"
    rm "$output"
}

case ${1-} in
run)
    [ $# = 4 ] || { sed -n '2,/^set/s/^# \{0,1\}//p' "$0" >&2; exit 2; }
    file=$2 first=$3 pieces=$4
    export SCIP_SIMULATION_PROGRAM=${SCIP_SIMULATION_PROGRAM:-$(build)}
    touch "$file"
    seq "$first" "$seeds" $((first + (pieces - 1) * seeds)) |
        xargs -P "$(nproc)" -I START "$0" piece "$file" START
    ;;
piece)
    # With 255 xargs starts no further piece.
    grep -q "^piece $3 " "$2" || piece "$3" >>"$2" || exit 255
    ;;
sum)
    [ $# = 2 ] || { sed -n '2,/^set/s/^# \{0,1\}//p' "$0" >&2; exit 2; }
    # Each line is a list of names and values; the slowest recoveries are not added up.
    awk '
        seen[$2]++ { print "piece " $2 " is there twice" > "/dev/stderr"; exit failed = 1 }
        {
            for (i = 3; i < NF; i += 2)
                if ($i ~ /^(usb|rs232|scip2)$/) { if ($(i + 1) > most[$i]) most[$i] = $(i + 1) }
                else sum[$i] += $(i + 1)
        }
        END {
            if (failed || !NR) exit 1
            printf "%d pieces, %d seeds, %.1f sensor-hours\n", NR, sum["seeds"], sum["hours"]
            printf "%d polls, %d scans checked, %d faults\n", sum["polls"], sum["checked"], sum["faults"]
            printf "SCIP 2: %.1f sensor-hours, %d scans checked, %d stamps by the clock, %d of them off by 2 ms\n", sum["scip2_hours"], sum["scip2_checked"], sum["stamps"], sum["off"]
            printf "slowest recovery: %.2f s on USB, %.2f s on RS-232, %.2f s on RS-232 in SCIP 2\n", most["usb"], most["rs232"], most["scip2"]
            printf "%.0f s of CPU time, %.1f sensor-hours a second\n", sum["seconds"], sum["hours"] / sum["seconds"]
        }' "$2"
    ;;
*)
    sed -n '2,/^set/s/^# \{0,1\}//p' "$0" >&2
    exit 2
    ;;
esac
