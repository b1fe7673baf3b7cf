"""Checks of the package and its units under systemd, on a Debian of its own. Started by a
unit of that Debian (run.py makes it), with its output on the console."""

import json
import os
import pathlib
import subprocess
import time
import urllib.request

from guest import Sensor, expect, run_checks, urg, wait

served, recorded = Sensor(0, "H0000001"), Sensor(1, "H0000002")
RECORDINGS = pathlib.Path("/var/lib/urg")


def systemctl(words, code=0):
    result = subprocess.run(["systemctl", *words.split()], capture_output=True, text=True)
    expect(code is None or result.returncode == code, f"systemctl {words}: {result.stdout}{result.stderr}")
    return result.stdout.strip()


def show(unit, name):
    return systemctl(f"show --value -p {name} {unit}")


def health():
    try:
        with urllib.request.urlopen("http://127.0.0.1:8080/health", timeout=5) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return None


def path_of(number):
    return RECORDINGS / ("scans.mcap" if number == 1 else f"scans_{number:04}.mcap")


def files():
    """Returns the size and the time of each recording, by its number."""
    found = {}
    # The newest first: an older one is removed before it.
    for path in sorted(RECORDINGS.glob("scans*.mcap"), reverse=True):
        try:
            state = path.stat()
        except FileNotFoundError:
            # It was removed in this moment.
            continue
        found[int(path.stem.partition("_")[2] or 1)] = state.st_size, state.st_mtime
    return found


def newest():
    """Returns the number and the size of the newest recording."""
    return max(((number, size) for number, (size, _) in files().items()), default=(0, 0))


def both_units_start_at_boot_without_a_sensor():
    for unit in ["urg-serve", "urg-record"]:
        wait(lambda: show(unit, "ActiveState") == "active", f"{unit} is not active")
        expect(show(unit, "NRestarts") == "0", f"{unit} restarted")
    expect(wait(health, "no answer of the page") == 503, "healthy without a sensor")


def sensors_that_are_plugged_in_later_are_found():
    served.plug()
    recorded.plug()
    wait(lambda: health() == 200, "the page has no scans")
    wait(lambda: newest() > (0, 0), "nothing is recorded")


def the_rule_gives_the_terminals_to_the_group():
    path = served.path()
    expect(pathlib.Path(path).group() == "dialout", pathlib.Path(path).group())
    expect(os.stat(path).st_mode & 0o777 == 0o660, oct(os.stat(path).st_mode))
    properties = subprocess.run(["udevadm", "info", "--query=property", path],
                                capture_output=True, text=True).stdout
    expect("ID_MM_DEVICE_IGNORE=1" in properties, properties)


def scans_come_back_after_a_loss():
    for sensor in [served, recorded]:
        sensor.unplug()
    wait(lambda: health() == 503, "the page is still healthy")
    for sensor in [served, recorded]:
        sensor.plug()
    wait(lambda: health() == 200, "the page has no scans")
    before = newest()
    wait(lambda: newest() > before, "nothing is recorded")
    expect(show("urg-serve", "NRestarts") == "0", "urg-serve restarted")


def a_killed_unit_is_started_again():
    for unit in ["urg-serve", "urg-record"]:
        systemctl(f"kill --signal KILL {unit}")
        wait(lambda: show(unit, "NRestarts") == "1", f"{unit} was not started again")
    wait(lambda: health() == 200, "the page has no scans")
    before = newest()
    wait(lambda: newest() > before, "nothing is recorded")


def scans_come_back_after_a_sleep_of_the_machine():
    """The kernel suspends the USB bus with it."""
    restarts = [show(unit, "NRestarts") for unit in ["urg-serve", "urg-record"]]
    expect("mem" in pathlib.Path("/sys/power/state").read_text(), "the kernel cannot sleep")
    print("@host sleep", flush=True)
    pathlib.Path("/sys/power/state").write_text("mem")
    before = newest()
    wait(lambda: health() == 200, "the page has no scans")
    wait(lambda: newest() > before, "nothing is recorded")
    found = [show(unit, "NRestarts") for unit in ["urg-serve", "urg-record"]]
    expect(found == restarts, f"restarts: {restarts}, then {found}")


def recordings_are_rotated_within_their_space_the_oldest_first():
    """`--split 3s --keep 300kB`, as in the settings."""
    wait(lambda: len(files()) >= 3, "no three files")
    first, last, most = min(files()), 0, 0
    end = time.monotonic() + 120
    while min(files()) < first + 3:
        expect(time.monotonic() < end, f"no three files were removed: {sorted(files())}")
        found = files()
        numbers = sorted(found)
        expect(numbers == list(range(numbers[0], numbers[-1] + 1)), f"a file between others is gone: {numbers}")
        expect(numbers[-1] >= last, f"{last} was removed while it was written: {numbers}")
        last, most = numbers[-1], max(most, sum(size for size, _ in found.values()))
        time.sleep(0.1)
    # 300 kB, and what comes within a second or two.
    expect(most < 400_000, f"{most} bytes")
    return f"at most {most} bytes"


def recordings_are_rotated_by_their_age():
    settings = pathlib.Path("/etc/default/urg")
    settings.write_text(settings.read_text().replace("--keep 300kB", "--keep 10s"))
    systemctl("restart urg-record")
    begun = max(files())
    wait(lambda: begun not in files() and len(files()) >= 2, f"file {begun} was not removed")
    age = time.time() - min(changed for _, changed in files().values())
    return f"the oldest of {len(files())} files is {age:.0f} s old"


def units_stop_cleanly():
    for unit in ["urg-serve", "urg-record"]:
        systemctl(f"stop {unit}")
        found = show(unit, "Result"), show(unit, "ExecMainStatus")
        expect(found == ("success", "0"), f"{unit}: {found}")
    last = path_of(max(files()))
    expect(json.loads(urg(f"info {last} --format json"))["complete"], f"{last} is incomplete")


def systemd_calls_the_sandbox_ok():
    figures = []
    for unit in ["urg-serve", "urg-record"]:
        text = subprocess.run(["systemd-analyze", "security", "--no-pager", f"{unit}.service"],
                              capture_output=True, text=True).stdout
        line = [line for line in text.splitlines() if "Overall exposure" in line][0]
        expect(line.split()[-2] == "OK" or " OK " in line, line)
        figures.append(line.split("service:")[-1].strip())
    return ", ".join(figures)


run_checks([
    both_units_start_at_boot_without_a_sensor,
    sensors_that_are_plugged_in_later_are_found,
    the_rule_gives_the_terminals_to_the_group,
    scans_come_back_after_a_loss,
    a_killed_unit_is_started_again,
    scans_come_back_after_a_sleep_of_the_machine,
    recordings_are_rotated_within_their_space_the_oldest_first,
    recordings_are_rotated_by_their_age,
    units_stop_cleanly,
    systemd_calls_the_sandbox_ok,
])
