"""A virtual machine with Debian's kernel, for checks that need real drivers or a power cut.

The machine boots in QEMU without KVM, from an initramfs that this file makes. Its root is
the host's, read-only under an overlay in memory, and it runs one Python script of the host
(`Machine(script, arguments)`); or, with `boot="disk"`, its root is the first disk, which
starts its own systemd. Lines that the script prints as `@host WORD …` are requests
to the host: `Machine.run` passes them to a function. The last line is `@end CODE`.

Needs qemu-system-x86_64, busybox (static), cpio, and the files of a Debian kernel package.
"""

import glob
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
# What the machine cannot mount its root without, and the drivers of the checks.
MODULES = [
    "virtio_pci", "virtio_blk", "9pnet_virtio", "9p", "overlay", "configfs", "ext4", "vfat",
    "dummy_hcd", "libcomposite", "usb_f_acm", "cdc-acm", "uhci-hcd", "ehci-pci", "ftdi_sio",
    "dm-flakey", "nls_cp437", "nls_ascii",
]
# The gadget driver has as many terminals.
OPTIONS = {"dummy_hcd": "num=8"}


class Skipped(Exception):
    """A tool or package is missing here."""


def tool(*names):
    for name in names:
        found = shutil.which(name)
        if found:
            return found
    raise Skipped(names[0])


def kernel(place):
    """Downloads and unpacks Debian's kernel once. Returns the folder."""
    folder = place / "kernel"
    if not glob.glob(f"{folder}/boot/vmlinuz-*"):
        depends = subprocess.run(
            ["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True
        ).stdout
        names = [line.split()[-1] for line in depends.splitlines() if "Depends: linux-image" in line]
        if not names:
            raise Skipped("a Debian kernel (linux-image-amd64)")
        folder.mkdir(parents=True, exist_ok=True)
        result = subprocess.run(
            ["apt-get", "download", "-qq", names[0]], cwd=folder, capture_output=True, text=True
        )
        packages = glob.glob(f"{folder}/*.deb")
        if not packages:
            raise Skipped(f"a Debian kernel: {result.stderr.strip()}")
        subprocess.run(["dpkg", "-x", packages[0], str(folder)], check=True)
        os.remove(packages[0])
    return folder


def modules(folder, drivers):
    """Returns the modules to load, as (path, options), each after those it needs."""
    version = os.path.basename(glob.glob(f"{folder}/lib/modules/*")[0])
    if not os.path.exists(f"{folder}/lib/modules/{version}/modules.dep.bin"):
        subprocess.run([tool("depmod"), "-b", str(folder), version], check=True)
    found = []
    for name in [*MODULES, *drivers]:
        lines = subprocess.run(
            [tool("modprobe"), "-d", str(folder), "-S", version, "--show-depends", name],
            capture_output=True, text=True, check=True,
        ).stdout.splitlines()
        for line in lines:
            words = line.split()
            if words[0] != "insmod":
                continue
            if words[1] not in [path for path, _ in found]:
                options = OPTIONS.get(name, "") if words[1].endswith(f"/{name}.ko") else ""
                found.append((words[1], options))
    return found


def initramfs(place, folder, script, arguments, boot, drivers):
    """Writes an initramfs with init, busybox, the modules and what init is to start."""
    root = place / "initramfs"
    shutil.rmtree(root, ignore_errors=True)
    (root / "bin").mkdir(parents=True)
    (root / "lib").mkdir()
    for name in ["proc", "sys", "dev"]:
        (root / name).mkdir()
    shutil.copy(tool("busybox"), root / "bin/busybox")
    shutil.copy(HERE / "init", root / "init")
    os.chmod(root / "init", 0o755)
    lines = []
    for path, options in modules(folder, drivers):
        shutil.copy(path, root / "lib")
        lines.append(f"insmod /lib/{os.path.basename(path)} {options}\n")
    (root / "modules").write_text("".join(lines))
    words = " ".join(arguments)
    (root / "environment").write_text(
        f"BOOT={boot}\nPYTHON={sys.executable}\nCHECKS={script}\nARGUMENTS='{words}'\n"
        "export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/tmp\n"
    )
    out = place / "initramfs.gz"
    subprocess.run(
        f"find . | {tool('cpio')} -o -H newc --quiet | gzip -1 >{out}", cwd=root, shell=True, check=True
    )
    return out


class Machine:
    """One boot. `options` are QEMU's, such as disks and devices; `drivers` are further modules."""

    def __init__(self, place, script, arguments=(), options=(), memory="1G", boot="host", drivers=()):
        place = pathlib.Path(place)
        folder = kernel(place)
        image = glob.glob(f"{folder}/boot/vmlinuz-*")[0]
        ram_disk = initramfs(place, folder, script, arguments, boot, drivers)
        self.control = str(place / "qmp")
        self.process = subprocess.Popen(
            [
                tool("qemu-system-x86_64"), "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2",
                "-m", memory, "-nodefaults", "-display", "none", "-no-reboot",
                "-kernel", image, "-initrd", str(ram_disk),
                # no_timer_check: on a busy host the kernel would miss the ticks that it counts.
                "-append", "console=ttyS0 quiet loglevel=1 panic=-1 random.trust_cpu=on no_timer_check",
                "-serial", "stdio", "-qmp", f"unix:{self.control},server=on,wait=off",
                "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
                "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
                *options,
            ],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace",
        )
        self.qmp = None

    def ask(self, command, **arguments):
        """Sends a command of QMP, such as `device_del`, and returns its answer."""
        if self.qmp is None:
            self.qmp = socket.socket(socket.AF_UNIX)
            self.qmp.connect(self.control)
            self.qmp.settimeout(20)
            self.qmp_lines = self.qmp.makefile()
            self.qmp_lines.readline()
            self.ask("qmp_capabilities")
        self.qmp.sendall(json.dumps({"execute": command, "arguments": arguments}).encode() + b"\n")
        while True:
            answer = json.loads(self.qmp_lines.readline())
            if "return" in answer or "error" in answer:
                return answer

    def cut_power(self):
        """Ends the machine as a pulled plug does."""
        self.process.kill()
        self.process.wait()

    def lines(self):
        """Yields the lines of the console, without the kernel's control characters."""
        for line in self.process.stdout:
            yield line.rstrip("\r\n")

    def run(self, on_request=lambda machine, words: None, seconds=300):
        """Prints what the checks print, until they end. Returns their exit code."""
        began = time.monotonic()
        for line in self.lines():
            if line.startswith("@host "):
                on_request(self, line.split()[1:])
            elif line.startswith("@end "):
                self.cut_power()
                return int(line.split()[1])
            else:
                print(line, flush=True)
            if time.monotonic() - began > seconds:
                self.cut_power()
                print(f"the machine took more than {seconds} s")
                return 1
        if self.process.poll() == -signal.SIGKILL:
            return 0
        print(f"the machine ended without a verdict: QEMU returned {self.process.wait()}")
        return 1
