"""What a recording writes to its disk, by the interval of its syncs: runs inside the machine,
with one ext4 disk for each interval: cost.py PROGRAM SECONDS INTERVAL…"""

import pathlib
import subprocess
import sys
import time

PROGRAM, SECONDS, INTERVALS = sys.argv[1], int(sys.argv[2]), sys.argv[3:]


class Recording:
    def __init__(self, letter, interval):
        self.interval, self.folder = interval, pathlib.Path(f"/mnt/{letter}")
        self.counters = pathlib.Path(f"/sys/block/vd{letter}/stat")
        self.folder.mkdir()
        # A new file system zeroes its inode tables in its first minutes: this mount does not.
        subprocess.run(["mount", "-o", "noinit_itable", f"/dev/vd{letter}", self.folder], check=True)

    def written(self):
        """Returns the completed writes, the written bytes and the flushes of the disk."""
        counts = [int(word) for word in self.counters.read_text().split()]
        return counts[4], counts[6] * 512, counts[15]

    def begin(self):
        self.process = subprocess.Popen(
            [PROGRAM, "record", "emulated", self.folder / "run.mcap", "--sync", self.interval],
            stderr=subprocess.DEVNULL)

    def size(self):
        return (self.folder / "run.mcap").stat().st_size


recordings = [Recording(letter, interval) for letter, interval in zip("abcdef", INTERVALS)]
for recording in recordings:
    recording.begin()
time.sleep(10)
subprocess.run(["sync"], check=True)
before = [(recording.written(), recording.size()) for recording in recordings]
time.sleep(SECONDS)
# What the system has put off belongs to this time, too.
subprocess.run(["sync"], check=True)
for recording, (written, size) in zip(recordings, before):
    writes, count, flushes = [(b - a) / SECONDS for a, b in zip(written, recording.written())]
    recorded = (recording.size() - size) / SECONDS
    print(f"--sync {recording.interval:4} {writes:6.2f} writes/s {flushes:5.2f} flushes/s {count / 1000:6.1f} kB/s "
          f"for {recorded / 1000:.1f} kB/s recorded")
print("@end 0", flush=True)
time.sleep(60)
