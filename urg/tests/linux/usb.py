"""Checks of the program against real USB drivers: cdc_acm, and ftdi_sio behind QEMU's
usb-serial. Runs inside the machine; `run.py` boots it."""

import fcntl
import json
import os
import pathlib
import signal
import sys
import threading
import time
import urllib.error
import urllib.request

from guest import Gadget, Running, Sensor, expect, hang_on, run_checks, urg, wait

first, second = Sensor(0, "H0000001"), Sensor(1, "H0000002")


def true_scans(stream, sensor, count):
    """Reads `count` scans, and returns the last. Each must be one that the sensor sent."""
    for _ in range(count):
        scan = stream.scan()
        expect(sensor.is_true(scan), f"scan {scan['sequence']} is not one that {sensor.serial_number} sent")
    return scan


def plug_both():
    for sensor in [first, second]:
        if not sensor.plugged:
            sensor.plug()
        wait(sensor.path, "no terminal of the gadget")


def list_names_both_sensors():
    ports = {port["path"]: port for port in json.loads(urg("list --format json"))}
    for sensor in [first, second]:
        expect(ports[sensor.path()]["likely_sensor"], f"{ports}")


def info_identifies_each():
    for sensor in [first, second]:
        text = urg(f"info {sensor.path()}")
        expect(sensor.serial_number in text and "USB" in text, text)


def check_passes():
    text = urg(f"check {first.path()}")
    return text.strip().splitlines()[-1]


def two_sensors_are_told_apart_by_serial_number():
    for sensor in [first, second]:
        found = json.loads(urg(f"info serial:{sensor.serial_number} --format json"))
        found = found["version"]["serial_number"]
        expect(found == sensor.serial_number, f"found {found}")


def every_scan_is_one_that_the_sensor_sent():
    stream = Running(f"stream {first.path()} --format ndjson")
    true_scans(stream, first, 30)


def hold(path):
    """Holds a terminal as another driver does."""
    terminal = hang_on(path)
    fcntl.flock(terminal, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return terminal


def scans_are_back_after_12_unplugs_beside_ten_ports_in_use():
    # In use all the time: each search finds these ports busy.
    beside = Running("stream serial:H0000002 --format ndjson")
    true_scans(beside, second, 5)
    # The gadget driver has no more than eight terminals.
    gadgets = [Gadget(number) for number in range(2, 8)]
    for gadget in gadgets:
        gadget.bind()
    host("plug adapter")
    host("plug hub")
    wait(lambda: len(adapters()) == 3, "no three /dev/ttyUSB")
    held = [hold(wait(gadget.path, "no terminal of the gadget")) for gadget in gadgets]
    held += [hold(path) for path in adapters()]
    stream = Running("stream serial:H0000001 --format ndjson")
    true_scans(stream, first, 5)
    times = []
    for n in range(12):
        first.unplug_at(["reply", "pause", "idle"][n % 3])
        wait(lambda: not os.path.exists("/dev/ttyACM0"), "the terminal is not gone")
        # Up to 3.3 s: the search is repeated, and waits in between.
        time.sleep(n * 0.3)
        for scan in stream.drain():
            expect(first.is_true(scan), f"scan {scan['sequence']} was never sent")
        first.plug()
        wait(lambda: os.path.exists("/dev/ttyACM0"), "no terminal after the replug", 0.005)
        began = time.monotonic()
        scan = stream.scan()
        times.append(time.monotonic() - began)
        expect(first.is_true(scan), f"scan {scan['sequence']} after unplug {n} was never sent")
        true_scans(stream, first, 2)
    for terminal in held:
        os.close(terminal)
    for gadget in gadgets:
        gadget.unbind()
    host("unplug adapter")
    host("unplug hub")
    wait(lambda: not adapters(), "a /dev/ttyUSB is not gone")
    told = " ".join(f"{time:.2f}" for time in sorted(times))
    expect(max(times) <= 1.5, f"back after {told} s")
    return f"back after {told} s"


def a_sensor_that_comes_back_under_another_name_is_found():
    stream = Running("stream serial:H0000001 --format ndjson")
    true_scans(stream, first, 3)
    before = first.path()
    held = hang_on(before)
    first.unplug()
    time.sleep(1)
    first.plug()
    wait(first.path, "no terminal after the replug")
    after = first.path()
    expect(after != before, f"the name {before} was free in spite of its holder")
    stream.drain()
    true_scans(stream, first, 3)
    os.close(held)
    return f"{before}, then {after}"


def both_pulled_at_once_come_back_with_their_names_exchanged():
    streams = [(Running(f"stream serial:{s.serial_number} --format ndjson"), s) for s in [first, second]]
    for stream, sensor in streams:
        true_scans(stream, sensor, 3)
    names = [first.path(), second.path()]
    first.unplug()
    second.unplug()
    wait(lambda: not first.path() and not second.path(), "the terminals are not gone")
    for stream, _ in streams:
        stream.drain()
    second.plug()
    wait(second.path, "no terminal")
    first.plug()
    wait(first.path, "no terminal")
    for stream, sensor in streams:
        true_scans(stream, sensor, 3)
    return f"{names}, then {[first.path(), second.path()]}"


def another_program_that_writes_AT_costs_no_wrong_scan():
    stream = Running(f"stream {first.path()} --format ndjson")
    true_scans(stream, first, 3)
    for _ in range(5):
        other = hang_on(first.path())
        os.write(other, b"AT\r")
        os.close(other)
        time.sleep(0.3)
        for scan in stream.drain():
            expect(first.is_true(scan), f"scan {scan['sequence']} was never sent")
    true_scans(stream, first, 5)


def a_bus_that_is_suspended_between_polls_costs_no_scan():
    """The kernel suspends an idle device only if told to: `power/control` is `on` by default."""
    device = pathlib.Path(os.path.realpath(f"/sys/class/tty/{os.path.basename(first.path())}/device")).parent
    stream = Running(f"stream {first.path()} --format ndjson --rate 0.2")
    true_scans(stream, first, 1)
    # Time for a reply: only the host's commands wake this device.
    (device / "power/autosuspend_delay_ms").write_text("1000")
    (device / "power/control").write_text("auto")
    status = device / "power/runtime_status"
    for _ in range(3):
        wait(lambda: status.read_text().strip() == "suspended", "the device is not suspended")
        true_scans(stream, first, 1)
    (device / "power/control").write_text("on")


def slowest_health(seconds):
    """Asks `/health` for some seconds, and returns the longest time that an answer took."""
    longest, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.monotonic()
        try:
            urllib.request.urlopen("http://127.0.0.1:8090/health", timeout=60).read()
        except urllib.error.HTTPError:
            pass  # 503: a sensor is away
        longest = max(longest, time.monotonic() - began)
        time.sleep(0.2)
    return longest


def a_sensor_that_takes_no_bytes_delays_no_other():
    """Closing its terminal takes 30 s."""
    server = Running(f"serve front=serial:H0000001 rear={second.path()} --listen 8090")
    arrivals = {"front": [], "rear": []}

    def read_scans():
        with urllib.request.urlopen("http://127.0.0.1:8090/scans") as lines:
            for line in lines:
                item = json.loads(line)
                if "values" in item:
                    arrivals[item["sensor"]].append(time.monotonic())

    wait(lambda: any("8090" in notice for notice in server.notices), "the server is not ready")
    threading.Thread(target=read_scans, daemon=True).start()
    wait(lambda: all(len(times) > 5 for times in arrivals.values()), "no scans of both")

    def largest_gap_and_slowest_health(seconds):
        began = time.monotonic()
        health = slowest_health(seconds)
        rear = [time for time in arrivals["rear"] if time > began]
        return max(after - before for before, after in zip(rear, rear[1:])), health

    machine = Lateness()
    first.hang()
    gap, health = largest_gap_and_slowest_health(50)
    first.recover()
    recovered = time.monotonic()
    wait(lambda: arrivals["front"][-1] > recovered, "no scan of a sensor that has recovered", 0.01)
    back = arrivals["front"][-1] - recovered
    first.hang()
    time.sleep(10)
    ended = end_of(server, signal.SIGINT)
    first.recover()
    late = machine.largest
    told = (f"gap {gap:.2f} s, /health {health:.2f} s, back after {back:.1f} s, Ctrl-C {ended:.2f} s; "
            f"the machine itself was late by {late:.2f} s")
    expect(gap < 0.5 + late and health < 1 + late and back < 1.5 + late and ended < 1 + late, told)
    return told


class Lateness(threading.Thread):
    """How late this machine wakes a thread that sleeps: an emulated one has gaps of its own."""

    def __init__(self):
        super().__init__(daemon=True)
        self.largest = 0
        self.start()

    def run(self):
        while True:
            due = time.monotonic() + 0.02
            time.sleep(0.02)
            self.largest = max(self.largest, time.monotonic() - due)


def end_of(running, sent=None):
    """Returns how long a program runs on, from the signal that it is sent."""
    began = time.monotonic()
    if sent:
        running.process.send_signal(sent)
    running.process.wait()
    return time.monotonic() - began


def commands_end_in_time_if_the_sensor_takes_no_bytes():
    stream = Running(f"stream {first.path()} --duration 6s --format ndjson")
    true_scans(stream, first, 5)
    began = time.monotonic()
    first.hang()
    stream.process.wait()
    duration = time.monotonic() - began

    began = time.monotonic()
    urg(f"info {second.path()}")
    usual_info = time.monotonic() - began
    began = time.monotonic()
    urg(f"info {first.path()}", code=1)
    info = time.monotonic() - began

    first.recover()
    stream = Running(f"stream {first.path()} --format ndjson")
    true_scans(stream, first, 5)
    first.hang()
    time.sleep(10)
    interrupt = end_of(stream, signal.SIGINT)

    first.recover()
    stream = Running(f"stream {first.path()} --format ndjson")
    true_scans(stream, first, 5)
    first.hang()
    time.sleep(2)
    killed = end_of(stream, signal.SIGKILL)
    first.recover()
    told = (f"--duration 6s {duration:.1f} s, info {info:.1f} s ({usual_info:.1f} s if healthy), "
            f"Ctrl-C {interrupt:.2f} s, kill -9 {killed:.1f} s")
    # `info` gives up after 5 s.
    expect(duration < 7 and info < 6 + usual_info and interrupt < 1, told)
    return told


def host(request):
    print(f"@host {request}", flush=True)


def adapters():
    return sorted(pathlib.Path("/dev").glob("ttyUSB*"))


def adapter():
    return next(iter(adapters()), None)


def a_sensor_behind_an_FTDI_adapter_is_found_at_each_baud_rate_and_after_a_replug():
    host("plug adapter")
    for baud, faster in [(19200, 57600), (57600, 115200), (115200, 19200)]:
        port = wait(adapter, "no /dev/ttyUSB")
        text = urg(f"info {port}")
        expect("H0713090" in text and f"{baud}" in text, text)
        stream = Running(f"stream {port} --format ndjson --cluster 4")
        for _ in range(3):
            stream.scan()
        host("unplug adapter")
        wait(lambda: not adapter(), "/dev/ttyUSB is not gone")
        host("plug adapter")
        wait(adapter, "no /dev/ttyUSB after the replug")
        stream.drain()
        for _ in range(3):
            stream.scan()
        stream.stop()
        urg(f"baud {port} {faster}")
    host("unplug adapter")
    wait(lambda: not adapter(), "/dev/ttyUSB is not gone")


def a_hub_that_is_pulled_takes_both_sensors_and_brings_both_back():
    host("plug hub")
    wait(lambda: len(adapters()) == 2, "no two /dev/ttyUSB")
    # The hub's ports come in their order, so each terminal has its name again.
    streams = [Running(f"stream {port} --format ndjson --cluster 4") for port in adapters()]
    for stream in streams:
        stream.scan()
    host("unplug hub")
    wait(lambda: not adapters(), "a /dev/ttyUSB is not gone")
    for stream in streams:
        stream.drain()
    began = time.monotonic()
    host("plug hub")
    for stream in streams:
        for _ in range(3):
            stream.scan()
    back = time.monotonic() - began
    for stream in streams:
        stream.stop()
    host("unplug hub")
    return f"both are back after {back:.1f} s"


ALL = [
    list_names_both_sensors,
    info_identifies_each,
    check_passes,
    two_sensors_are_told_apart_by_serial_number,
    every_scan_is_one_that_the_sensor_sent,
    scans_are_back_after_12_unplugs_beside_ten_ports_in_use,
    a_sensor_that_comes_back_under_another_name_is_found,
    both_pulled_at_once_come_back_with_their_names_exchanged,
    another_program_that_writes_AT_costs_no_wrong_scan,
    a_bus_that_is_suspended_between_polls_costs_no_scan,
    a_sensor_that_takes_no_bytes_delays_no_other,
    commands_end_in_time_if_the_sensor_takes_no_bytes,
    a_sensor_behind_an_FTDI_adapter_is_found_at_each_baud_rate_and_after_a_replug,
    a_hub_that_is_pulled_takes_both_sensors_and_brings_both_back,
]

run_checks([check for check in ALL if not sys.argv[2:] or any(word in check.__name__ for word in sys.argv[2:])], plug_both)
