#!/usr/bin/env python3
"""Boots the machine for one set of checks: run.py usb|adapters|system|power|fat|services|cost PROGRAM PLACE
[…]. PLACE is a folder for the kernel and the machine's files. Prints `skipped: TOOL` where
something is missing."""

import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time

from machine import HERE, Machine, Skipped, tool


def usb(program, place, names):
    """cdc_acm on dummy_hcd, and FTDI adapters whose lines are pseudo-terminals here, which
    keep their baud rates as a line does. Two of them are on a hub."""
    emulators, options = [], ["-device", "piix3-usb-uhci,id=uhci"]
    for name, serial_number in [("adapter", "H0713090"), ("left", "H0000003"), ("right", "H0000004")]:
        link = place / name
        link.unlink(missing_ok=True)
        emulators.append(subprocess.Popen(
            [program, "emulate", "--baud", "19200", "--link", link, "--serial-number", serial_number],
            stderr=subprocess.DEVNULL))
        while not link.exists():
            time.sleep(0.02)
        options += ["-chardev", f"serial,id={name},path={link.resolve()}"]

    def add(machine, name, port, driver="usb-serial", **device):
        # The line is free a moment after the former adapter is gone.
        for _ in range(50):
            answer = machine.ask("device_add", driver=driver, id=name, bus="uhci.0", port=port, **device)
            if "error" not in answer:
                return
            time.sleep(0.1)
        show(answer)

    def on_request(machine, words):
        if words == ["plug", "adapter"]:
            add(machine, "adapter", "1", chardev="adapter")
        elif words == ["unplug", "adapter"]:
            show(machine.ask("device_del", id="adapter"))
        elif words == ["plug", "hub"]:
            add(machine, "hub", "2", driver="usb-hub")
            add(machine, "left", "2.1", chardev="left")
            add(machine, "right", "2.2", chardev="right")
        elif words == ["unplug", "hub"]:
            # In this order, because QEMU ends if a hub is deleted before what is plugged into
            # it: within milliseconds.
            for name in ["left", "right", "hub"]:
                show(machine.ask("device_del", id=name))

    try:
        return Machine(place, HERE / "usb.py", [program, *names], options).run(on_request, 300)
    finally:
        for emulator in emulators:
            emulator.kill()


def adapters(program, place, names):
    """RS-232 adapters with chips of several makers."""
    drivers = ["vhci-hcd", "cp210x", "ch341", "pl2303", "mos7840", "ti_usb_3410_5052"]
    return Machine(place, HERE / "adapters.py", [program, *names], drivers=drivers).run(seconds=600)


def system(program, place, arguments):
    """A clock that is set, a machine that is frozen, little memory, a disk that fails."""
    tool("dmsetup")
    image = new_disk(place)

    def on_request(machine, words):
        if words[0] == "freeze":
            machine.ask("stop")
            time.sleep(float(words[1]))
            machine.ask("cont")

    disk = ["-drive", f"file={image},if=virtio,format=raw"]
    return Machine(place, HERE / "system.py", [program, *arguments], disk).run(on_request, 300)


def cost(program, place, arguments):
    """Measures what recordings write to their disks: `cost PROGRAM PLACE [SECONDS]`."""
    seconds, intervals = (arguments or ["300"])[0], ["1s", "10s", "0"]
    disks = []
    for interval in intervals:
        disks += ["-drive", f"file={new_disk(place, f'disk-{interval}')},if=virtio,format=raw"]
    return Machine(place, HERE / "cost.py", [program, seconds, *intervals], disks).run(seconds=int(seconds) + 300)


def fat(program, place, arguments):
    """Records beyond the 4 GiB of a file on FAT: `fat BENCH PLACE`, with the program of
    `recording/benches/recorder.rs`."""
    image = new_disk(place, "fat", "6G", "mkfs.vfat", "-F", "32")
    disk = ["-drive", f"file={image},if=virtio,format=raw,cache=unsafe"]
    code = Machine(place, HERE / "fat.py", [program], disk).run(seconds=7200)
    image.unlink()
    return code


def new_disk(place, name="disk", size="256M", make="mkfs.ext4", *options):
    """Makes a file system with its defaults, in a file."""
    image = place / name
    image.unlink(missing_ok=True)
    subprocess.run(["truncate", "--size", size, image], check=True)
    subprocess.run([tool(make), *(options or ["-q"]), image], check=True, stdout=subprocess.DEVNULL)
    return image


def power(program, place, arguments):
    """Cuts the power at random moments: `power PROGRAM PLACE [CUTS [SEED]]`. After each cut
    the disk is what it was: its journal is replayed, and each recording is read."""
    cuts, seed = [int(word) for word in arguments] + [2, 1][len(arguments):]
    readers, moments = readers_of_others(place), random.Random(seed)
    losses, failed, unfinished, splits = [], 0, 0, 0
    # In memory, so that what else the host writes does not slow the disk down.
    memory = pathlib.Path(tempfile.mkdtemp(prefix="urg-", dir="/dev/shm"))
    for cut in range(cuts):
        image, files = new_disk(memory), place / "files"
        seconds, clock, until = moments.uniform(1, 10), [], []

        def on_request(machine, words):
            if words[0] == "ready":
                until.append(time.monotonic() + seconds)
            else:
                clock[:] = [float(words[1])]
            if until and time.monotonic() >= until[0]:
                machine.cut_power()

        disk = ["-drive", f"file={image},if=virtio,format=raw,cache=writethrough"]
        Machine(place, HERE / "power.py", [program], disk).run(on_request, 300)
        # 1: errors that are corrected, such as the orphans of removed files.
        checked = subprocess.run([tool("e2fsck"), "-fy", image], capture_output=True, text=True)
        shutil.rmtree(files, ignore_errors=True)
        files.mkdir()
        subprocess.run([tool("debugfs"), "-R", f"rdump / {files}", image], stderr=subprocess.DEVNULL, check=True)
        unfinished += any(files.glob("repaired.mcap.*.part"))
        try:
            expect(until and clock, "the recordings did not begin")
            expect(checked.returncode <= 1, checked.stdout)
            lost, name, has_begun = judge(program, files, clock[0], readers)
            losses.append(lost)
            splits += has_begun
            print(f"ok      cut {cut + 1} after {seconds:4.1f} s: lost {lost:.2f} s at most, in {name}", flush=True)
        except Exception as error:
            failed += 1
            print(f"FAILED  cut {cut + 1} after {seconds:4.1f} s: {error}", flush=True)
    shutil.rmtree(memory)
    if losses:
        losses.sort()
        print(f"lost at {len(losses)} cuts: {losses[len(losses) // 2]:.2f} s (median), {losses[-1]:.2f} s (worst); "
              f"{unfinished} cuts during a repair, {splits} right after a split")
    return int(failed > 0)


def expect(good, text):
    if not good:
        raise AssertionError(text)


def services(program, place, arguments):
    """The package under systemd, in a Debian of its own: `services PROGRAM PLACE PACKAGE`."""
    package, root, image = pathlib.Path(arguments[0]), place / "debian", place / "debian.disk"
    if not (root / "lib/systemd/systemd").exists():
        shutil.rmtree(root, ignore_errors=True)
        subprocess.run([tool("mmdebstrap"), "--quiet", "--variant=minbase",
                        "--include=systemd,systemd-sysv,udev,dbus,python3", "bookworm", root], check=True)
    shutil.copy(package, root / "root/urg.deb")
    for name in ["guest.py", "services.py"]:
        shutil.copy(HERE / name, root / "root")
    (root / "etc/systemd/system/checks.service").write_text(CHECKS_UNIT)
    chroot = ["chroot", root]
    subprocess.run([*chroot, "sh", "-ec", INSTALL], check=True, stdout=subprocess.DEVNULL)
    image.unlink(missing_ok=True)
    subprocess.run(["truncate", "--size", "1G", image], check=True)
    subprocess.run([tool("mkfs.ext4"), "-q", "-d", root, image], check=True)
    disk = ["-drive", f"file={image},if=virtio,format=raw,cache=unsafe"]

    def on_request(machine, words):
        """`@host sleep`: wakes the machine once it sleeps."""
        while machine.ask("query-status")["return"]["status"] != "suspended":
            time.sleep(0.2)
        show(machine.ask("system_wakeup"))

    return Machine(place, "", [], disk, boot="disk").run(on_request, 600)


CHECKS_UNIT = """[Unit]
After=multi-user.target
[Service]
ExecStart=/usr/bin/python3 -u /root/services.py /usr/bin/urg
StandardOutput=tty
StandardError=tty
TTYPath=/dev/ttyS0
[Install]
WantedBy=multi-user.target
"""

# As a user does it; apt would also fetch what the package depends on, which is nothing.
INSTALL = """
apt-get install --reinstall -y /root/urg.deb
sed -i 's/^URG_SERVE=.*/URG_SERVE=serial:H0000001/; s/^URG_RECORD=.*/URG_RECORD=serial:H0000002/
    s/^URG_RECORD_OPTIONS=.*/URG_RECORD_OPTIONS="--split 3s --keep 300kB"/' /etc/default/urg
systemctl enable urg-serve urg-record checks
systemctl mask serial-getty@ttyS0 getty@tty1 systemd-networkd-wait-online apt-daily.timer apt-daily-upgrade.timer
"""


def readers_of_others(place):
    """Returns a command that counts the scans in recordings with two readers that others
    wrote, or None where they cannot be installed."""
    venv = place / "readers"
    python = venv / "bin/python3"
    installed = [[sys.executable, "-m", "venv", venv],
                 [python, "-m", "pip", "install", "--quiet", "mcap-ros2-support", "rosbags"]]
    if all(subprocess.run(command, stderr=subprocess.DEVNULL).returncode == 0 for command in installed):
        return [python, HERE / "readers.py"]
    print("skipped: the readers of recordings")
    return None


def judge(program, files, end, readers):
    """Returns how many seconds of scans before `end` are missing from the recordings that
    ran, and from which one, and whether a part had just begun. Fails if more than two are missing, or if a file
    cannot be read."""
    repaired = files / "repaired.mcap"
    again = repaired.with_suffix(".again.mcap")
    urg(program, "repair", files / "cut.mcap", again)
    if not repaired.exists():
        urg(program, "repair", files / "cut.mcap", repaired)
    expect(repaired.read_bytes() == again.read_bytes(), "the repaired file is not complete")
    parts = sorted(files.glob("split*.mcap"))
    single = [files / "run.mcap", files / "zstd.mcap"]
    last = {path: last_scan(program, path) for path in [*single, *parts]}
    begun = [path for path in parts if last[path] is None]
    expect(begun == parts[len(parts) - len(begun):], f"no scans in {[path.name for path in begun]}")
    for path in begun:
        # Nothing of it was on the disk yet.
        last.pop(parts.pop())
    expect(parts and all(last[path] for path in single), "no scans")
    lost, name = max((end - last[path], path.name) for path in [*single, parts[-1]])
    expect(lost <= 2, f"expected at most 2 s to be lost, found {lost:.2f} s in {name}")
    if readers:
        whole = [again, *[whole_file(path) for path in last]]
        counts = json.loads(subprocess.run([*readers, *whole], capture_output=True, text=True, check=True).stdout)
        for path, found in counts.items():
            scans = json.loads(urg(program, "info", path, "--format", "json"))["scans"]
            # The last reply may be in the file without its scan.
            expect(found in [[scans] * 2, [scans - 1] * 2], f"{path}: {scans} scans, others found {found}")
    return lost, name, bool(begun)


def urg(program, *arguments):
    result = subprocess.run([program, *arguments], capture_output=True, text=True)
    expect(result.returncode == 0, result.stderr.strip())
    return result.stdout


def whole_file(path):
    """Returns the file that `urg repair` made of a recording, or the recording if it was
    complete."""
    repaired = path.with_suffix(".again.mcap")
    return repaired if repaired.exists() else path


def last_scan(program, path):
    """Returns the time of the last scan of a recording, repaired first if it has to be.
    None if there is none."""
    repair = subprocess.run([program, "repair", path, path.with_suffix(".again.mcap")],
                            capture_output=True, text=True)
    if "no message in it can be read" in repair.stderr:
        return None
    expect(repair.returncode == 0, repair.stderr.strip())
    lines = urg(program, "stream", whole_file(path), "--rate", "max", "--format", "ndjson").splitlines()
    stamps = [stamp for stamp in [json.loads(line).get("stamp") for line in lines] if stamp]
    return stamps[-1] if stamps else None


def show(answer):
    if "error" in answer:
        print(f"QEMU: {answer['error']['desc']}")


if __name__ == "__main__":
    checks, program, place = sys.argv[1], str(pathlib.Path(sys.argv[2]).resolve()), pathlib.Path(sys.argv[3])
    place.mkdir(parents=True, exist_ok=True)
    try:
        # Some checks bound times: what else this host does should not count.
        os.nice(-10)
    except PermissionError:
        pass
    try:
        run = {"usb": usb, "adapters": adapters, "system": system, "power": power, "fat": fat, "services": services,
               "cost": cost}[checks]
        sys.exit(run(program, place.resolve(), sys.argv[4:]))
    except Skipped as missing:
        print(f"skipped: {missing}")
