#!/usr/bin/env bash
# chrony 4.3 (Debian 12) lets CLOCK_MONOTONIC run a twelfth fast or slow for ten seconds, to correct the time of day.
#
# Expected of a clock for intervals: it does not depend on the time of day, or by 500 ppm at most, as with `adjtime`.
# But chrony changes the kernel's tick if it does not step, and that drives both clocks: CLOCK_MONOTONIC_RAW alone
# keeps its pace. With Debian's configuration that happens to a machine whose clock is up to 1 s off when it starts. A
# timer of 1 s takes 0.92 s then, and a motor of 600 rpm seems to turn at 554. It runs in QEMU, whose clock it may set.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import shutil
import subprocess

from place import PLACE, compare, debian

# The machine's only program besides chrony. It tells chrony that its clock is off by 0.9 s, as a receiver of GPS
# would, and prints the pace of the monotonic clock each second.
PROGRAM = """
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <sys/mount.h>
#include <sys/reboot.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

double now(clockid_t clock) {
    timespec at;
    clock_gettime(clock, &at);
    return at.tv_sec + at.tv_nsec * 1e-9;
}

int main(int, char** arguments) {
    mkdir("/dev", 0755), mkdir("/proc", 0755), mkdir("/run", 0755), mkdir("/run/chrony", 0750);
    mount("dev", "/dev", "devtmpfs", 0, nullptr), mount("proc", "/proc", "proc", 0, nullptr);
    if (fork() == 0) execl("/usr/sbin/chronyd", "chronyd", "-d", "-u", "root", "-f", "/chrony.conf", nullptr);
    const double ahead = now(CLOCK_REALTIME) + atof(getenv("OFFSET")) - now(CLOCK_MONOTONIC_RAW);
    const int sender = socket(AF_UNIX, SOCK_DGRAM, 0);
    const sockaddr_un address = {AF_UNIX, "/run/time.sock"};
    for (int second = 0; second < 30; second++) {
        const double raw = now(CLOCK_MONOTONIC_RAW), monotonic = now(CLOCK_MONOTONIC);
        sleep(1);
        struct { timeval at; double offset; int pulse, leap, padding, magic; } sample = {};
        gettimeofday(&sample.at, nullptr);
        sample.offset = ahead + now(CLOCK_MONOTONIC_RAW) - (sample.at.tv_sec + sample.at.tv_usec * 1e-6);
        sample.magic = 0x534f434b;
        sendto(sender, &sample, sizeof sample, 0, (const sockaddr*)&address, sizeof address);
        printf("pace %.4f\\n", (now(CLOCK_MONOTONIC) - monotonic) / (now(CLOCK_MONOTONIC_RAW) - raw));
        fflush(stdout);
    }
    reboot(RB_POWER_OFF);
}
"""
CONFIGURATION = """
refclock SOCK /run/time.sock poll 0
makestep 1 3
maxupdateskew 100.0
"""

about = ["apt-cache", "depends", "linux-image-cloud-amd64"]
depends = subprocess.run(about, capture_output=True, text=True, check=True)
kernel = next(line.split()[-1] for line in depends.stdout.splitlines() if "Depends: linux-image" in line)
libraries = ["libc6", "libcap2", "libedit2", "libbsd0", "libmd0", "libtinfo6", "libgnutls30", "libnettle8",
             "libhogweed6", "libgmp10", "libidn2-0", "libunistring2", "libp11-kit0", "libtasn1-6", "libffi8",
             "libseccomp2"]
root = debian("chrony=4.3-2+deb12u3", kernel, *libraries)
image = next((root / "boot").glob("vmlinuz-*")).rename(PLACE / "vmlinuz")
for package in root.glob("*.deb"):
    package.unlink()
for folder in ("boot", "usr/lib/modules", "lib/modules", "usr/share"):
    shutil.rmtree(root / folder, ignore_errors=True)
(root / "chrony.conf").write_text(CONFIGURATION)
for file, line in (("passwd", "root:x:0:0::/:/"), ("group", "root:x:0:")):
    (root / "etc" / file).write_text(line + "\n")
(PLACE / "program.cpp").write_text(PROGRAM)
subprocess.run(["g++", "-static", "-o", root / "init", PLACE / "program.cpp"], check=True)
names = "\n".join(str(path.relative_to(root)) for path in root.rglob("*"))
pack = ["cpio", "--quiet", "-o", "-H", "newc"]
archive = subprocess.run(pack, cwd=root, input=names.encode(), capture_output=True, check=True)
(PLACE / "initramfs").write_bytes(archive.stdout)


def pace(offset):
    """The pace of the monotonic clock that differs most from the raw one's, and whether it lasted."""
    command = ["qemu-system-x86_64", "-nodefaults", "-nographic", "-no-reboot", "-m", "512", "-serial", "stdio",
               "-kernel", image, "-initrd", PLACE / "initramfs",
               "-append", f"console=ttyS0 quiet panic=-1 OFFSET={offset}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL)
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("pace ")]
    paces = [round(float(pace), 3) for _, pace in lines]
    farthest = max(paces, key=lambda pace: abs(pace - 1))
    return farthest, "for 8 s or longer" if paces.count(farthest) >= 8 else "for less"


print(kernel)
seen = {"0.9 s behind": pace(0.9), "0.9 s ahead": pace(-0.9)}
compare(seen, {"0.9 s behind": (1.083, "for 8 s or longer"), "0.9 s ahead": (0.917, "for 8 s or longer")})
END
