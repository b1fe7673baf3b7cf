"""Checks of the program on RS-232 adapters with the kernel's drivers cp210x, ch341, pl2303, mos7840 and
ti_usb_3410_5052. The chips are Python (`usbip.py`). Runs inside the machine; `run.py` boots it.

A chip sets the speed of its line to what the driver's control requests ask for. The line is the
pseudo-terminal of `urg emulate`, on which a wrong speed makes garbage."""

import fcntl
import os
import pathlib
import struct
import subprocess
import sys
import threading
import time
import tty

from guest import PROGRAM, Running, expect, run_checks, wait
from usbip import IN, Device, Stall

REQUESTS = [19200, 38400, 57600, 115200, 250000, 500000, 750000]
TCGETS2, TCSETS2 = 0x802C542A, 0x402C542B
BOTHER, ANY_SPEED = 0x1000, 0x100F
TIOCGSERIAL, TIOCSSERIAL, LOW_LATENCY = 0x541E, 0x541F, 1 << 13
LINK = "/tmp/line"


def get_speed(file):
    return struct.unpack_from("I", fcntl.ioctl(file, TCGETS2, bytes(44)), 40)[0]


def set_speed(file, speed):
    settings = bytearray(fcntl.ioctl(file, TCGETS2, bytes(44)))
    flags = struct.unpack_from("I", settings, 8)[0] & ~ANY_SPEED | BOTHER
    struct.pack_into("I", settings, 8, flags)
    struct.pack_into("II", settings, 36, speed, speed)
    fcntl.ioctl(file, TCSETS2, bytes(settings))


class Adapter(Device):
    """A chip, and the line to its sensor."""

    endpoints = ((0x81, 2, 64), (0x01, 2, 64))
    speed = 0

    def __init__(self):
        super().__init__()
        self.line = self.sensor = None

    def power(self, baud=19200):
        """Gives the sensor power, at 19,200 baud unless a program has moved it."""
        self.cut_power()
        self.sensor = subprocess.Popen(
            [PROGRAM, "emulate", "--link", LINK, "--baud", str(baud), "--serial-number", "H0713090"],
            stderr=subprocess.DEVNULL)
        wait(lambda: os.path.exists(LINK), "no line")
        self.line = os.open(LINK, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.line)
        self.set_line(self.speed)
        threading.Thread(target=self._read, args=[self.line], daemon=True).start()

    def cut_power(self):
        if self.sensor:
            self.sensor.terminate()
            self.sensor.wait()
            self.sensor = self.line = None

    def _read(self, line):
        try:
            while data := os.read(line, 256):
                self.receive(data)
        except OSError:
            pass
        os.close(line)

    def set_line(self, speed):
        self.speed = speed
        if self.line and speed:
            set_speed(self.line, speed)

    def write(self, data):
        if self.line:
            os.write(self.line, data)


class Cp210x(Adapter):
    """The host sends a number, which the CP2102 takes if it is in its table."""

    ids, usb_release = (0x10C4, 0xEA60), 0x0200
    texts = ("Silicon Labs", "CP2102 USB to UART Bridge Controller", "0001")
    part = 2

    def control(self, kind, request, value, index, data, length):
        if kind & IN:
            # The number of the part; all else may be zero.
            return bytes([self.part]) + bytes(length - 1) if (request, value) == (0xFF, 0x370B) else bytes(length)
        if request == 0x1E:
            self.set_line(struct.unpack("<I", data)[0])


class Cp2104(Cp210x):
    texts = ("Silicon Labs", "CP2104 USB to UART Bridge Controller", "01234567")
    part = 4


class Ch341(Adapter):
    ids, release = (0x1A86, 0x7523), 0x0263
    texts = (None, "USB2.0-Serial", None)
    endpoints = ((0x82, 2, 32), (0x02, 2, 32), (0x81, 3, 8))

    def control(self, kind, request, value, index, data, length):
        if request == 0x5F:
            return b"\x31\x00"
        if request == 0x95:
            return b"\xff\xee"
        if (request, value) == (0x9A, 0x1312):
            prescaler, factor, divisor = index & 3, index >> 2 & 1, 256 - (index >> 8)
            self.set_line(round(48e6 / ((1 << 12 - 3 * prescaler - factor) * divisor)))


class Pl2303(Adapter):
    """HX: numbers of a list, or a divisor. The chip is said to take 9,600 for other numbers."""

    ids, release, usb_release = (0x067B, 0x2303), 0x0300, 0x0110
    texts = ("Prolific Technology Inc.", "USB-Serial Controller", None)
    endpoints = ((0x81, 3, 10), (0x02, 2, 64), (0x83, 2, 64))
    numbers = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
    settings = bytes(7)

    def control(self, kind, request, value, index, data, length):
        if (kind, request) == (0xA1, 0x21):
            return self.settings
        if (kind, request) == (0x21, 0x20):
            self.settings = data
            number = struct.unpack_from("<I", data)[0]
            self.set_line(self.divided(number) if number >> 31 else number if number in self.numbers else 9600)
        return bytes(length)

    def divided(self, number):
        return round(384e6 / ((number & 511) << 2 * (number >> 9 & 7)))


class Pl2303Ta(Pl2303):
    usb_release = 0x0200

    def divided(self, number):
        return round(384e6 / ((number & 2047) << ((number >> 12 & 14) | (number >> 16 & 1))))


class Mcs7810(Adapter):
    """A UART of the 16550 kind: the driver chooses its clock and its divisor."""

    ids, usb_release = (0x9710, 0x7810), 0x0200
    texts = ("MosChip Semiconductor", "USB-Serial Controller", None)
    endpoints = ((0x81, 2, 64), (0x02, 2, 64), (0x83, 3, 16))
    clocks = (115200, 230400, 403200, 460800, 806400, 921600, 1572864, 3145728)

    def __init__(self):
        super().__init__()
        self.registers = {}

    def control(self, kind, request, value, index, data, length):
        # The UART is application 1; its first two registers are the divisor while bit 7 of the fourth is set.
        application = value >> 8
        is_divisor = application == 1 and index < 2 and self.registers.get((1, 3), 0) & 0x80
        place = (application, f"divisor{index}" if is_divisor else index)
        if kind & IN:
            return bytes([self.registers.get(place, 0)]) + bytes(length - 1)
        self.registers[place] = value & 0xFF
        divisor = self.registers.get((1, "divisor1"), 0) << 8 | self.registers.get((1, "divisor0"), 0)
        if divisor:
            self.set_line(round(self.clocks[self.registers.get((0, 0), 0) >> 4 & 7] / divisor))


class Ti3410(Adapter):
    """With its firmware, which the driver loads into a new one."""

    ids = (0x0451, 0x3410)
    texts = ("Texas Instruments", "TUSB3410", None)
    configuration = 2
    endpoints = ((0x81, 2, 64), (0x01, 2, 64), (0x83, 3, 2))

    def control(self, kind, request, value, index, data, length):
        if kind & IN:
            # The transmitter is empty.
            return bytes(4) + b"\x60" + bytes(length)
        if request == 5 and (divisor := struct.unpack_from(">H", data)[0]):
            self.set_line(round(24e6 / 26 / divisor))


CHIPS = {"CP2102": Cp210x, "CP2104": Cp2104, "CH340": Ch341, "PL2303 HX": Pl2303, "PL2303 TA": Pl2303Ta,
         "MCS7810": Mcs7810, "TUSB3410": Ti3410}


def port():
    return next((str(path) for path in pathlib.Path("/dev").glob("ttyUSB*")), None)


class Plugged:
    """A chip while it is plugged in."""

    def __init__(self, name, sensor=None):
        self.chip, self.baud = CHIPS[name](), sensor

    def __enter__(self):
        if self.baud:
            self.chip.power(self.baud)
        self.chip.plug()
        self.chip.path = wait(port, "no /dev/ttyUSB")
        return self.chip

    def __exit__(self, *_):
        self.chip.unplug()
        wait(lambda: not port(), "/dev/ttyUSB is not gone")
        self.chip.cut_power()


def opened(path):
    file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(file)
    return file


# What each chip runs at for these requests, and in brackets what the terminal reports if that is
# not the chip's speed.
SPEEDS = {
    "CP2102": [19200, 38400, 57600, 115200, 250000, 500000, 921600],
    "CP2104": [19200, 38400, 57553, 115384, 250000, 500000, 750000],
    "CH340": [(19231, 19200), (38462, 38400), (57692, 57600), (115385, 115200), 250000, 500000, 750000],
    "PL2303 HX": REQUESTS,
    "PL2303 TA": REQUESTS,
    "MCS7810": [19200, 38400, 57600, 115200, (403200, 250000), (806400, 500000), (806400, 750000)],
    "TUSB3410": [(19231, 19200), (38462, 38400), (57692, 57600), (115385, 115200), (230769, 250000),
                 (461538, 500000), (923077, 750000)],
}


def each_driver_sets_the_speeds_of_its_table():
    for name, speeds in SPEEDS.items():
        with Plugged(name) as chip:
            file = opened(chip.path)
            for request, expected in zip(REQUESTS, speeds):
                set_speed(file, request)
                expected = expected if isinstance(expected, tuple) else (expected, expected)
                found = (chip.speed, get_speed(file))
                expect(found == expected, f"{name} at {request}: expected {expected}, found {found}")
            os.close(file)


def no_driver_keeps_low_latency():
    for name in CHIPS:
        with Plugged(name) as chip:
            file = opened(chip.path)
            settings = bytearray(fcntl.ioctl(file, TIOCGSERIAL, bytes(72)))
            struct.pack_into("I", settings, 16, LOW_LATENCY)
            fcntl.ioctl(file, TIOCSSERIAL, bytes(settings))
            flags = struct.unpack_from("I", fcntl.ioctl(file, TIOCGSERIAL, bytes(72)), 16)[0]
            expect(not flags & LOW_LATENCY, f"{name} keeps it")
            os.close(file)


def closing_waits_for_an_adapter_that_takes_no_bytes():
    """Which no program should feel."""
    times = {}
    for name in ["CH340", "TUSB3410"]:
        with Plugged(name, 19200) as chip:
            chip.hold(True)
            file = opened(chip.path)
            os.write(file, b"V\n")
            began = time.monotonic()
            os.close(file)
            times[name] = time.monotonic() - began
            began = time.monotonic()
            told("info", chip.path, code=1)
            info = time.monotonic() - began
            expect(info < 9, f"{name}: urg info took {info:.1f} s")
            chip.hold(False)
    expect(times["CH340"] > 25 and times["TUSB3410"] < 5, f"close: {times}")
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in times.items())


def told(*arguments, code=0):
    """Returns what the program says, on both of its outputs."""
    result = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, timeout=120)
    text = (result.stdout + result.stderr).strip()
    expect(result.returncode == code, f"{arguments}: expected {code}, found {result.returncode}: {text}")
    return text


def the_sensor_works_at_each_speed_of_its_adapter():
    for name in ["CP2102", "CP2104", "CH340", "PL2303 HX", "PL2303 TA"]:
        with Plugged(name, 19200) as chip:
            expect("H0713090" in told("info", chip.path), name)
            for baud in [57600, 115200, 250000, 500000, 750000][:4 if name == "CP2102" else 5]:
                told("baud", chip.path, str(baud))


def a_speed_that_the_driver_refuses_is_named():
    with Plugged("CP2102", 19200) as chip:
        text = told("baud", chip.path, "750000", code=1)
        expect("expected 750000 baud, the port runs at 921600" in text, text)
        expect("H0713090" in told("info", chip.path), "the sensor was moved")
    with Plugged("CP2102", 750000) as chip:
        text = told("info", chip.path, code=1)
        expect("power-cycle it if it is at 750000 baud, which the port lacks" in text, text)


def a_speed_that_the_driver_only_claims_is_refused():
    for name, driver in [("MCS7810", "mos7840"), ("TUSB3410", "ti_usb_3410_5052")]:
        with Plugged(name, 19200) as chip:
            told("baud", chip.path, "115200")
            text = told("baud", chip.path, "250000", code=1)
            expect(f"the kernel's driver {driver}" in text and "or another adapter" in text, text)
            expect("H0713090" in told("info", chip.path), "the sensor was moved")
        with Plugged(name, 250000) as chip:
            text = told("info", chip.path, code=1)
            expect("if it is at 250000 or 500000 or 750000 baud, which the port lacks" in text, text)


def scans_are_back_after_a_replug():
    times = {}
    for name in CHIPS:
        with Plugged(name, 19200) as chip:
            stream = Running(f"stream {chip.path} --format ndjson --cluster 4")
            stream.scan()
            chip.unplug()
            wait(lambda: not port(), "/dev/ttyUSB is not gone")
            time.sleep(0.5)
            chip.plug()
            expect(wait(port, "no /dev/ttyUSB") == chip.path, "another name")
            began = time.monotonic()
            stream.drain()
            stream.scan()
            times[name] = time.monotonic() - began
            stream.stop()
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in times.items())


ALL = [
    each_driver_sets_the_speeds_of_its_table,
    no_driver_keeps_low_latency,
    closing_waits_for_an_adapter_that_takes_no_bytes,
    the_sensor_works_at_each_speed_of_its_adapter,
    a_speed_that_the_driver_refuses_is_named,
    a_speed_that_the_driver_only_claims_is_refused,
    scans_are_back_after_a_replug,
]
run_checks([check for check in ALL if not sys.argv[2:] or any(word in check.__name__ for word in sys.argv[2:])])
