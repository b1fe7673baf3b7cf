"""A file on FAT that may not grow beyond 4 GiB: runs inside the machine, with PROGRAM of
`recording/benches/recorder.rs`."""

import pathlib
import subprocess
import sys
import time

PROGRAM, DISK = sys.argv[1], pathlib.Path("/mnt")

subprocess.run(["mount", "-t", "vfat", "/dev/vda", DISK], check=True)
code = subprocess.run([PROGRAM, "outgrow", DISK]).returncode
print(f"@end {code}", flush=True)
time.sleep(60)
