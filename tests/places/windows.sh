#!/usr/bin/env bash
# Runs the tests for Windows under Wine, then the program: bash tests/places/windows.sh
# [NAMES…], which are passed to the tests. left_out.txt lists what is left out, and why.
#
# Needs on Debian: gcc-mingw-w64-x86-64 wine64 wine, and python3 for the serial port.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=x86_64-pc-windows-gnu

for tool in wine x86_64-w64-mingw32-gcc; do
    command -v "$tool" || { echo "skipped: $tool" && exit 0; }
done
if [ ! -d "$(rustc --print target-libdir --target "$target")" ] && ! rustup target add "$target"; then
    echo "skipped: the std of $target" && exit 0
fi

export SCIP_SIMULATION_HOURS="${SCIP_SIMULATION_HOURS:-1}" SCIP_TEST_LIMIT_MINUTES=60
messages=$(cargo test --locked --no-run --workspace --lib --bins --tests --target "$target" \
    --message-format json)
built() { grep -o '"executable":"[^"]*"' <<<"$messages" | cut -d'"' -f4 | grep -E "$1"; }

work=$(mktemp -d)
export WINEPREFIX=$work/wine WINEDEBUG=-all
trap 'wineserver --kill || true; rm -rf "$work"' EXIT
wine wineboot --init
# Rust's std takes random numbers from a library that Wine 8 lacks.
library=$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll
if [ ! -e "$library" ]; then
    cat >"$work/random.c" <<'EOF'
#include <windows.h>
#include <ntsecapi.h>
__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE data, SIZE_T length) {
    return RtlGenRandom(data, (ULONG)length);
}
EOF
    x86_64-w64-mingw32-gcc -shared -o "$library" "$work/random.c" -ladvapi32
fi

failed=0
left_out=()
while read -r name; do
    left_out+=(--skip "$name")
done < <(sed -n 's/^windows  *\([^ ]*\).*/\1/p' tests/places/left_out.txt)
for executable in $(built '/deps/'); do
    wine "$executable" "${left_out[@]}" "$@" || failed=1
done

# The program, on an emulated sensor, on TCP, and on a serial port: COM1 is a
# pseudo-terminal of this machine.
urg=$(built '/urg\.exe$')
expect() {
    local wanted=$1 found
    shift
    found=$(timeout 60 wine "$urg" "$@" 2>&1 || true)
    grep -qF -- "$wanted" <<<"$found" && echo "ok: urg $*" && return
    printf 'urg %s: expected %s, found\n%s\n' "$*" "$wanted" "$found" >&2
    failed=1
}
expect '"sequence":19' stream emulated --count 20
expect 'not a terminal' view emulated
expect 'plug the sensor in' info COM9

# Ctrl-C. Wine has a console only in a terminal, and sends it to all programs there.
cat >"$work/ctrl_c.c" <<'EOF'
#include <windows.h>
static BOOL WINAPI ignore(DWORD event) { return TRUE; }
int main(int count, char **arguments) {
    STARTUPINFOA start = {.cb = sizeof start};
    PROCESS_INFORMATION urg;
    WIN32_FILE_ATTRIBUTE_DATA file = {0};
    DWORD code = 1;
    SetConsoleCtrlHandler(ignore, TRUE);
    if (!CreateProcessA(NULL, arguments[1], NULL, NULL, TRUE, 0, NULL, NULL, &start, &urg)) return 1;
    while (!GetFileAttributesExA(arguments[2], GetFileExInfoStandard, &file) || !file.nFileSizeLow)
        Sleep(100);
    GenerateConsoleCtrlEvent(CTRL_C_EVENT, 0);
    if (WaitForSingleObject(urg.hProcess, 20000)) TerminateProcess(urg.hProcess, 1);
    WaitForSingleObject(urg.hProcess, INFINITE);
    GetExitCodeProcess(urg.hProcess, &code);
    return code;
}
EOF
x86_64-w64-mingw32-gcc -o "$work/ctrl_c.exe" "$work/ctrl_c.c"
file=$(winepath --windows "$work/run.mcap")
recording="$(winepath --windows "$urg") record emulated $file"
timeout 60 script --quiet --return --command "wine '$work/ctrl_c.exe' '$recording' '$file'" \
    /dev/null </dev/null >"$work/terminal" ||
    { cat "$work/terminal" >&2 && echo "urg record: expected success after Ctrl-C" >&2 && failed=1; }
expect '"complete":true' info "$file" --format json

here=$(cargo build --locked -p urg --message-format json |
    grep -o '"executable":"[^"]*/urg"' | tail -n 1 | cut -d'"' -f4)
"$here" emulate --tcp 0 2>"$work/tcp" &
tcp=$!
"$here" emulate --baud 19200 --link "$work/sensor" 2>"$work/serial" &
serial=$!
trap 'kill $tcp $serial || true; wineserver --kill || true; rm -rf "$work"' EXIT
until grep -q ', on ' "$work/tcp" && grep -q ', on ' "$work/serial"; do sleep 0.1; done
expect 'serial number  H0713090' info "$(sed -n 's/.*, on //p' "$work/tcp")"
# Wine cannot read a baud rate that is not one of POSIX, as the emulator sets it.
stty -F "$work/sensor" 19200
wine reg add 'HKLM\Software\Wine\Ports' /v COM1 /d "$work/sensor"
wineserver --wait || true
expect 'COM1' list
# A port that is only listed must not be opened: prints how often a file was opened.
opens() {
    python3 - "$@" <<'EOF'
import ctypes, os, subprocess, sys
libc, IN_OPEN = ctypes.CDLL(None), 0x20
notices = libc.inotify_init1(os.O_NONBLOCK)
libc.inotify_add_watch(notices, sys.argv[1].encode(), IN_OPEN)
subprocess.run(sys.argv[2:], capture_output=True)
try:
    print(len(os.read(notices, 1 << 16)) // 16)
except BlockingIOError:
    print(0)
EOF
}
for arguments in list 'info COM9'; do
    count=$(opens "$work/sensor" wine "$urg" $arguments)
    [ "$count" = 0 ] && echo "ok: urg $arguments opens no port" && continue
    echo "urg $arguments: expected COM1 not to be opened, found $count opens" >&2
    failed=1
done
expect 'baud rate      19200' info COM1
expect 'is 115200 baud' baud COM1 115200
expect '"sequence":4' stream '\\.\com1' --count 5
# A pseudo-terminal has no DTR. With this library each process has one, and records what it is set to.
cat >"$work/modem.c" <<'EOF'
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ioctl.h>
int ioctl(int file, unsigned long request, ...) {
    static int lines;
    va_list rest;
    va_start(rest, request);
    int *argument = va_arg(rest, int *);
    va_end(rest);
    if (request != TIOCMGET && request != TIOCMSET)
        return ((int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl"))(file, request, argument);
    if (request == TIOCMGET) return *argument = lines, 0;
    FILE *record = fopen(getenv("DTR_RECORD"), "a");
    fprintf(record, "%d", ((lines = *argument) & TIOCM_DTR) != 0);
    return fclose(record);
}
EOF
cc -shared -fPIC -o "$work/modem.so" "$work/modem.c"
for arguments in 'info COM1' 'baud COM1 57600' 'baud COM1 115200'; do
    rm -f "$work/dtr"
    DTR_RECORD=$work/dtr LD_PRELOAD=$work/modem.so timeout 60 wine "$urg" $arguments >/dev/null 2>&1 || true
    grep -q '1$' "$work/dtr" && echo "ok: urg $arguments raises DTR" && continue
    echo "urg $arguments: expected DTR to be raised in the end, found $(cat "$work/dtr")" >&2
    failed=1
done
# Wine has no 750000 baud: the driver must notice, and keep the former.
expect 'cannot be set to 750000' baud COM1 750000
expect 'baud rate      115200' info COM1
exit "$failed"
