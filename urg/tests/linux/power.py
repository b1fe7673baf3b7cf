"""What records while the power is cut: runs inside the machine, on an ext4 disk with its
defaults, until the host ends the machine. Prints its clock twenty times a second.

`run.mcap` is one file, and so is `zstd.mcap`. `split*.mcap` are compressed with lz4 and begin every 0.6 s, and
`repaired.mcap` is made of `cut.mcap` again and again, so that some cuts hit these moments."""

import pathlib
import re
import subprocess
import sys
import time

PROGRAM = sys.argv[1]
DISK = pathlib.Path("/mnt")

subprocess.run(["mount", "-t", "ext4", "/dev/vda", DISK], check=True)
emulator = subprocess.Popen([PROGRAM, "emulate", "--tcp", "0"], stderr=subprocess.PIPE, text=True)
port = None
while port is None:
    found = re.search(r"tcp://[\d.:]+", emulator.stderr.readline())
    port = found and found[0]


def start(arguments):
    return subprocess.Popen([PROGRAM, *arguments.split()], stderr=subprocess.DEVNULL)


def run(arguments):
    subprocess.run([PROGRAM, *arguments.split()], check=True, stderr=subprocess.DEVNULL)


def size(name):
    path = DISK / name
    return path.stat().st_size if path.exists() else 0


run(f"record emulated {DISK}/whole.mcap --count 20 --rate max")
copies = [DISK / f"copy{number}.mcap" for number in range(20)]
for copy in copies:
    copy.hardlink_to(DISK / "whole.mcap")
run(f"cut {' '.join(map(str, copies))} {DISK}/joined.mcap")
joined = (DISK / "joined.mcap").read_bytes()
(DISK / "cut.mcap").write_bytes(joined[:len(joined) * 2 // 3])
for file in [*copies, DISK / "joined.mcap"]:
    file.unlink()
subprocess.run(["sync"], check=True)
start(f"record {port} {DISK}/run.mcap")
start(f"record emulated {DISK}/zstd.mcap --compress zstd")
start(f"record emulated {DISK}/split.mcap --split 30kB --compress lz4")
# The first scans are written.
while not (DISK / "split_0003.mcap").exists() or min(size("run.mcap"), size("zstd.mcap")) < 20_000:
    time.sleep(0.05)
print("@host ready", flush=True)
repair = None
while True:
    if repair is None or repair.poll() is not None:
        (DISK / "repaired.mcap").unlink(missing_ok=True)
        repair = start(f"repair {DISK}/cut.mcap {DISK}/repaired.mcap")
    print(f"@host clock {time.time():.3f}", flush=True)
    time.sleep(0.05)
