#!/usr/bin/env bash
# MRPT 2.5.8 (Debian 12): its driver of Hokuyo's sensors gives the same stamps again after 4.7 hours.
#
# SCIP 2 sends the sensor's clock, in 24 bits of milliseconds, so that it begins again then. Expected: stamps that
# continue. But the driver subtracts the value at its start, in 32 bits. Scans are 49.5 days ahead until the clock has
# passed that value, and 4.7 hours behind from then on. With `disable_firmware_timestamp` it takes the time of
# arrival. MRPT's source of 2025 has the same lines.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import itertools
import socket
import subprocess
import threading

from place import compare, mrpt

# The driver takes the times of arrival for the first ten scans.
FIRST, SCANS = 10, 40
# Milliseconds between scans, of which the test leaves out most, and of the clock at the first stamp.
STEP, START = 1_000_000, 4_200_000
STATE = {
    "MODL": "UST-10LX", "DMIN": 20, "DMAX": 30000, "ARES": 1440, "AMIN": 0, "AMAX": 1080, "AFRT": 540, "SCAN": 2400}

PROGRAM = """
#include <iostream>
#include <mrpt/hwdrivers/CHokuyoURG.h>

int main(int, char** arguments) {
    mrpt::hwdrivers::CHokuyoURG sensor;
    sensor.setIPandPort("127.0.0.1", std::stoi(arguments[1]));
    while (!sensor.turnOn()) {}
    for (int scans = std::stoi(arguments[2]); scans > 0;) {
        bool is_scan = false, failed = false;
        mrpt::obs::CObservation2DRangeScan scan;
        sensor.doProcessSimple(is_scan, scan, failed);
        if (!is_scan) continue;
        scans--;
        std::cout << "stamp " << std::fixed << mrpt::Clock::toDouble(scan.timestamp) << std::endl;
    }
}
"""


def with_sum(line):
    return line + chr((sum(line.encode()) & 0x3F) + 0x30) + "\n"


def coded(number, characters):
    return "".join(chr((number >> 6 * place & 0x3F) + 0x30) for place in reversed(range(characters)))


def scan(number):
    """A wall at 1 m all around."""
    clock = START + (number - FIRST) * STEP
    data = coded(1000, 3) * 1081
    lines = [with_sum(data[at : at + 64]) for at in range(0, len(data), 64)]
    return with_sum(coded(clock & 0xFFFFFF, 4)) + "".join(lines)


def sense(listener):
    client, _ = listener.accept()
    for line in client.makefile(newline="\n"):
        command = line.rstrip()
        answer = "".join(with_sum(f"{name}:{value};") for name, value in STATE.items()) if command == "PP" else ""
        client.sendall(f"{command}\n00P\n{answer}\n".encode())
        if command.startswith("MD"):
            for number in range(SCANS):
                client.sendall(f"{command}\n99b\n{scan(number)}\n".encode())


program = mrpt(PROGRAM, "libmrpt-hwdrivers-dev", folders=["pulseaudio"],
               links=["hwdrivers", "obs", "poses", "rtti", "serialization", "system", "core"])
with socket.create_server(("127.0.0.1", 0)) as listener:
    threading.Thread(target=sense, args=[listener], daemon=True).start()
    run = [program, str(listener.getsockname()[1]), str(SCANS)]
    printed = subprocess.run(run, capture_output=True, text=True, check=True).stdout
stamps = [float(line.split()[-1]) for line in printed.splitlines() if line.startswith("stamp ")][FIRST:]
wrong = [stamp - stamps[0] - number * STEP / 1000 for number, stamp in enumerate(stamps)]
groups = itertools.groupby(round(seconds / 3600, 1) for seconds in wrong)
seen = {"hours ahead, and how many scans": [(hours, len(list(scans))) for hours, scans in groups]}
compare(seen, dict(zip(seen, [[(0, 13), (1188.4, 4), (-4.7, 13)]])))
END
