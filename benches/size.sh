#!/usr/bin/env bash
# The size of a service on this crate: dependencies, time of a clean release build,
# size of the program, compared with a program that opens the same port with tokio and
# tokio-serial alone. Then it measures the CPU time a scan, with cargo's defaults and with less
# code, and the CPU time of `urg stream` if its path is given; what the service keeps on the heap
# (needs valgrind and jq); and the dependencies and the build time that each feature adds.
# bash benches/size.sh [URG]
set -euo pipefail
urg=${1:+$(realpath "$1")}
crate=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# Cargo's defaults, which a service has, and not the profile that urg is released with;
# the versions in Cargo.lock.
unset CARGO_TARGET_DIR CARGO_INCREMENTAL RUSTFLAGS
export CARGO_PROFILE_RELEASE_LTO=false CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16

package() {
    local name=$1
    mkdir -p "$work/$name/src"
    { printf '[package]\nname = "%s"\nversion = "0.0.0"\nedition = "2024"\n' "$name"
      printf '[dependencies]\n'; cat; } >"$work/$name/Cargo.toml"
    cp "$crate/Cargo.lock" "$work/$name/"
}

package bare <<END
tokio = { version = "1", features = ["rt", "time", "macros", "io-util"] }
tokio-serial = { version = "5", default-features = false }
END
cat >"$work/bare/src/main.rs" <<'END'
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_serial::SerialPortBuilderExt;

#[tokio::main(flavor = "current_thread")]
async fn main() -> std::io::Result<()> {
    let path = std::env::args().nth(1).unwrap_or_default();
    let mut port = tokio_serial::new(path, 19_200).open_native_async()?;
    AsyncWriteExt::write_all(&mut port, b"G04472501\n").await?;
    let mut reply = [0; 1399];
    AsyncReadExt::read_exact(&mut port, &mut reply).await?;
    println!("{} bytes", reply.len());
    Ok(())
}
END

package service <<END
tokio = { version = "1", features = ["rt", "macros"] }
tokio-scip = { path = "$crate" }
END
cat >"$work/service/src/main.rs" <<'END'
use tokio_scip::{Rate, Sensor, Window};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), tokio_scip::Error> {
    let path = std::env::args().nth(1).unwrap_or_default();
    let count = std::env::args().nth(2).and_then(|count| count.parse().ok()).unwrap_or(20);
    let sensor = Sensor::open(path.as_str()).await?;
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    for _ in 0..count {
        let Some(scan) = scans.next().await else { break };
        println!("{} points", scan?.points().count());
    }
    // At once, so that the heap is as it was in service.
    std::process::exit(0)
}
END

TIMEFORMAT='%R %U'
echo "program   crates    build     CPU        size   stripped"
for name in bare service; do
    cd "$work/$name"
    cargo fetch --quiet
    crates=$(cargo tree --edges normal --prefix none --no-dedupe | sort -u | wc -l)
    # Seconds on the clock and of CPU time; CPU time varies less.
    read -r seconds cpu < <({ time cargo build --quiet --release --offline; } 2>&1)
    program=target/release/$name
    size=$(stat -c %s "$program")
    strip "$program"
    printf '%-9s %6d %7.0f s %6.0f s %7d KiB %5d KiB\n' "$name" $((crates - 1)) "$seconds" "$cpu" \
        $((size / 1024)) $(($(stat -c %s "$program") / 1024))
done

# The sensor: a URG on USB, on a pseudo-terminal.
cd "$crate"
sensor=$(cargo bench --quiet --locked --no-run --bench pieces --message-format json |
    sed -n 's/.*"name":"pieces".*"executable":"\([^"]*\)".*/\1/p')
exec 3< <(exec "$sensor" serve frames)
trap 'rm -rf "$work"; kill '$! EXIT
read -r port <&3

cd "$work/service"
CARGO_PROFILE_RELEASE_LTO=fat CARGO_PROFILE_RELEASE_CODEGEN_UNITS=1 \
    cargo build --quiet --release --offline --target-dir "$work/fat"
TIMEFORMAT='%3U %3S'
# Microseconds of CPU time a scan: what the start of a program takes is in both runs.
cpu() {
    local scans
    for scans in 20 120; do
        { time "${@//SCANS/$scans}" 2>&4 | cat >/dev/null; } 4>/dev/null 2>&1
    done | awk '{ total = $1 + $2 } NR == 1 { start = total } END { print (total - start) * 1e4 }'
}
median() { sort -n | sed -n 3p; }
for ((round = 0; round < 5; round++)); do
    cpu target/release/service "$port" SCANS >>defaults
    cpu "$work/fat/release/service" "$port" SCANS >>fat
    [ -z "$urg" ] || cpu "$urg" stream "$port" --count SCANS >>urg
done
echo "CPU time a scan, median of five, and median of the ratios"
for name in defaults fat ${urg:+urg}; do
    ratio=$(paste "$name" defaults | awk '{ print $1 / $2 }' | median)
    echo "$name: $(median <"$name") us, $ratio of the defaults; $(paste "$name" fat |
        awk '{ print $1 / $2 }' | median) of fat"
done

if command -v valgrind >/dev/null && command -v jq >/dev/null; then
    echo "bytes on the heap after 20 scans, the runtime's own left out"
    CARGO_PROFILE_RELEASE_DEBUG=line-tables-only cargo build --quiet --release --offline --target-dir "$work/debug"
    valgrind --tool=dhat --read-inline-info=no --num-callers=30 --dhat-out-file=heap \
        "$work/debug/release/service" "$port" >/dev/null 2>&1
    # Groups blocks by the first function of this crate that their allocation passed through.
    jq -r '.ftbl as $names | .pps[] | select(.eb > 0) | .eb as $bytes |
        [.fs[] | $names[.] | capture("(?<name>tokio_scip::[^( ]*)").name][0] // empty |
        "\($bytes) \(.)"' heap |
        awk '{ sum[$2] += $1; all += $1 } END { for (name in sum) print sum[name], name; print all, "in all" }' |
        sort -rn
fi

TIMEFORMAT='%R %U'
echo "features     crates    build     CPU"
for features in serial serial,serde serial,tcp urg-emulator urg-recording urg urg,dds urg,zenoh; do
    cd "$crate"
    case $features in
    urg-*) with=(-p "$features") ;;
    urg*) with=(-p urg --features "${features#urg}") ;;
    *) with=(-p tokio-scip --no-default-features --features "$features") ;;
    esac
    export CARGO_TARGET_DIR="$work/features"
    crates=$(cargo tree "${with[@]}" --edges normal --prefix none --no-dedupe | sort -u | wc -l)
    read -r seconds cpu < <({ time cargo build --quiet --release --locked --offline "${with[@]}"; } 2>&1)
    rm -rf "$CARGO_TARGET_DIR"
    printf '%-15s %3d %7.0f s %6.0f s\n' "$features" $((crates - 1)) "$seconds" "$cpu"
done
