"""Checks of the program on a machine that is out of things: time, memory, a disk. Runs
inside the machine; `run.py` boots it."""

import ctypes
import json
import pathlib
import signal
import statistics
import subprocess
import time

from guest import PROGRAM, Running, Sensor, expect, run_checks, urg, wait

sensor = Sensor(0, "H0000001")
HOUR = 3600


def plug():
    if not sensor.plugged:
        sensor.plug()
    wait(sensor.path, "no terminal of the gadget")


def true_scans(stream, count):
    scans = [stream.scan() for _ in range(count)]
    for scan in scans:
        expect(sensor.is_true(scan), f"scan {scan['sequence']} was never sent")
    return scans


def step_clock(seconds):
    time.clock_settime(time.CLOCK_REALTIME, time.time() + seconds)


def no_scan_has_a_time_between_two_clocks():
    """The clock is set an hour ahead, and back. A scan has the old time or the new one."""
    stream = Running(f"stream {sensor.path()} --format ndjson")
    scans = true_scans(stream, 10)
    for step in [HOUR, -HOUR]:
        before = time.time()
        step_clock(step)
        for scan in true_scans(stream, 20):
            stamp = scan["stamp"]
            near_old, near_new = abs(stamp - before) < 30, abs(stamp - before - step) < 30
            expect(near_old or near_new, f"stamp {stamp}, clocks {before} and {before + step}")
        expect(near_new, "the last scan has the old time")
        scans.append(scan)


def a_clock_that_is_set_is_told_once_by_info():
    """An hour ahead and an hour back, in one recording."""
    path = pathlib.Path("/run/clock.mcap")
    recording = Running(f"record {sensor.path()} {path}")

    def grows():
        size = path.stat().st_size if path.exists() else 0
        wait(lambda: path.exists() and path.stat().st_size > size + 20_000, "nothing was recorded")

    grows()
    for step in [HOUR, -HOUR]:
        step_clock(step)
        grows()
    recording.process.send_signal(signal.SIGINT)
    expect(recording.process.wait() == 0, f"{recording.notices}")
    steps = [round(step["seconds"]) for step in json.loads(urg(f"info {path} --format json"))["clock"]]
    expect(steps == [HOUR, -HOUR], f"{steps}")


def a_clock_that_is_slewed_bends_no_interval():
    stream = Running(f"stream {sensor.path()} --format ndjson")
    true_scans(stream, 5)
    libc = ctypes.CDLL(None, use_errno=True)
    delta = (ctypes.c_long * 2)(2, 0)
    expect(libc.adjtime(delta, None) == 0, "adjtime failed")
    stamps = [scan["stamp"] for scan in true_scans(stream, 40)]
    steps = [b - a for a, b in zip(stamps, stamps[1:])]
    expect(min(steps) > 0, f"times go back: {min(steps)}")
    return f"median interval {statistics.median(steps) * 1000:.1f} ms"


def a_machine_that_was_frozen_for_10_s_goes_on():
    stream = Running(f"stream {sensor.path()} --format ndjson")
    true_scans(stream, 5)
    stream.drain()
    print("@host freeze 10", flush=True)
    time.sleep(1)
    scans = true_scans(stream, 30)
    expect(scans[-1]["stamp"] - scans[-10]["stamp"] < 30, "no steady scans after the pause")
    return f"{len(stream.notices)} notices"


def little_memory_costs_no_scan():
    group = pathlib.Path("/sys/fs/cgroup/urg")
    if not group.parent.is_mount():
        subprocess.run(["mount", "-t", "cgroup2", "cgroup2", group.parent], check=True)
    (group.parent / "cgroup.subtree_control").write_text("+memory")
    group.mkdir(exist_ok=True)
    (group / "memory.max").write_text("24M")
    stream = Running(f"stream {sensor.path()} --format ndjson")
    (group / "cgroup.procs").write_text(str(stream.process.pid))
    # The same group reads a file, so that its page cache is taken from it all the time.
    greedy = subprocess.Popen(["sh", "-c", f"echo $$ >{group}/cgroup.procs; while :; do cat {PROGRAM}; done"],
                              stdout=subprocess.DEVNULL)
    try:
        true_scans(stream, 40)
    finally:
        greedy.kill()
    return f"peak {int((group / 'memory.peak').read_text()) >> 20} MiB" if (group / "memory.peak").exists() else ""


def dmsetup(*words):
    subprocess.run(["dmsetup", *words], check=True, capture_output=True)


def a_disk_that_fails_ends_the_recording_with_a_message_and_loses_nothing_before():
    sectors = int(pathlib.Path("/sys/block/vda/size").read_text())
    dmsetup("create", "--noudevsync", "disk", "--table", f"0 {sectors} flakey /dev/vda 0 3600 0")
    dmsetup("mknodes")
    subprocess.run(["mount", "-t", "ext4", "/dev/mapper/disk", "/mnt"], check=True)
    stream = Running("record emulated /mnt/run.mcap")
    time.sleep(6)
    expect(stream.process.poll() is None, f"the recording ended early: {stream.notices}")
    dmsetup("suspend", "--noudevsync", "--noflush", "--nolockfs", "disk")
    # From now on every write and read fails.
    dmsetup("reload", "disk", "--table", f"0 {sectors} error")
    dmsetup("resume", "--noudevsync", "disk")
    wait(lambda: stream.process.poll() is not None, "the recording did not end")
    expect(stream.process.returncode == 1, f"exit code {stream.process.returncode}")
    text = "\n".join(stream.notices)
    expect("/mnt/run.mcap" in text and text.count("Input/output error") == 1, text)
    subprocess.run(["umount", "-l", "/mnt"], check=False)
    return stream.notices[-1]


run_checks([
    no_scan_has_a_time_between_two_clocks,
    a_clock_that_is_set_is_told_once_by_info,
    a_clock_that_is_slewed_bends_no_interval,
    a_machine_that_was_frozen_for_10_s_goes_on,
    little_memory_costs_no_scan,
    a_disk_that_fails_ends_the_recording_with_a_message_and_loses_nothing_before,
], plug)
