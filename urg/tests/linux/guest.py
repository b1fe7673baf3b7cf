"""What the checks inside the machine share: sensors on USB cables, the program, verdicts.

A sensor here is `urg emulate` behind a USB gadget: its cable is the gadget's binding to a
controller of `dummy_hcd`, and the other end is a real `cdc_acm` terminal, /dev/ttyACM*.
Every reply that passes the cable is kept, so that each scan of the program can be compared
with what its sensor sent.
"""

import fcntl
import json
import os
import pathlib
import queue
import re
import select
import socket
import subprocess
import sys
import termios
import threading
import time
import tty

GADGETS = pathlib.Path("/sys/kernel/config/usb_gadget")
PROGRAM = sys.argv[1]
# Seconds to wait for anything. All of it takes a few; the host may be busy.
PATIENCE = 60


class Failure(Exception):
    """A check failed: what was expected, and what was found."""


def expect(good, text):
    if not good:
        raise Failure(text)


def wait(condition, text, interval=0.05):
    """Returns the first true value of `condition`."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(interval)
    raise Failure(f"{text} within {PATIENCE} s")


def run_checks(checks, prepare=lambda: None):
    """Runs each check after `prepare`, prints a line each, and ends the machine."""
    failed = 0
    for check in checks:
        name, began = check.__name__.replace("_", " "), time.monotonic()
        try:
            prepare()
            figure = check() or ""
            print(f"ok      {time.monotonic() - began:5.1f} s  {name}{figure and ': '}{figure}")
        except Exception as error:  # a defect of a check counts as its failure
            failed += 1
            print(f"FAILED  {time.monotonic() - began:5.1f} s  {name}: {type(error).__name__}: {error}")
        for thing in list(Running.all):
            thing.stop()
    print(f"@end {int(failed > 0)}", flush=True)
    time.sleep(60)


class Running:
    """A process of the program whose standard output is read line by line."""

    all = []

    def __init__(self, arguments, environment=None):
        self.process = subprocess.Popen(
            [PROGRAM, *arguments.split()], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, **(environment or {})},
        )
        self.lines, self.notices = queue.Queue(), []
        threading.Thread(target=self._read, daemon=True).start()
        threading.Thread(target=self._notices, daemon=True).start()
        Running.all.append(self)

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put(None)

    def _notices(self):
        for line in self.process.stderr:
            self.notices.append(line.rstrip())

    def scan(self):
        """Returns the next scan of `urg stream --format ndjson`, and skips its events."""
        end = time.monotonic() + PATIENCE
        while True:
            try:
                line = self.lines.get(timeout=max(0, end - time.monotonic()))
            except queue.Empty:
                raise Failure(f"no scan within {PATIENCE} s; notices: {self.notices[-3:]}") from None
            if line is None:
                raise Failure(f"the stream ended; notices: {self.notices[-3:]}")
            item = json.loads(line)
            if "values" in item:
                return item

    def drain(self):
        """Takes the scans that are there already."""
        scans = []
        while not self.lines.empty():
            line = self.lines.get()
            if line and "values" in line:
                scans.append(json.loads(line))
        return scans

    def stop(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        if self in Running.all:
            Running.all.remove(self)


def urg(arguments, code=0):
    """Runs the program to its end, and returns its standard output."""
    result = subprocess.run(
        [PROGRAM, *arguments.split()], capture_output=True, text=True, timeout=2 * PATIENCE
    )
    expect(result.returncode == code, f"urg {arguments}: expected exit code {code}, found "
           f"{result.returncode}: {result.stderr.strip()[-400:]}")
    return result.stdout


def decode(reply):
    """Returns the first step and the values of a complete reply to `G`, or None. Written
    from the protocol text, and independent of the driver."""
    lines = reply.split(b"\n")
    if len(lines) < 3 or not re.fullmatch(rb"G\d{8}", lines[0]) or lines[1] != b"0":
        return None
    data = b"".join(lines[2:])
    values = [(high - 0x30) << 6 | (low - 0x30) for high, low in zip(data[::2], data[1::2])]
    return int(lines[0][1:4]), values


class Gadget:
    """A USB device with the ids of a sensor and a terminal."""

    def __init__(self, number):
        self.number = number
        folder = self.folder = GADGETS / f"urg{number}"
        (folder / "strings/0x409").mkdir(parents=True)
        (folder / "configs/c.1/strings/0x409").mkdir(parents=True)
        function = folder / "functions" / f"acm.{number}"
        function.mkdir(parents=True)
        for name, value in [
            ("idVendor", "0x15d1"), ("idProduct", "0x0000"), ("bcdUSB", "0x0200"),
            ("bDeviceClass", "2"),
            # Without remote wakeup, cdc_acm keeps the device awake while its terminal is open.
            ("configs/c.1/bmAttributes", "0xa0"),
            ("strings/0x409/manufacturer", "Hokuyo Data Flex for USB"),
            ("strings/0x409/product", "URG-Series USB Driver"),
        ]:
            (folder / name).write_text(value)
        os.symlink(function, folder / "configs/c.1" / f"acm.{number}")
        self.near = f"/dev/ttyGS{(function / 'port_num').read_text().strip()}"

    def bind(self):
        (self.folder / "UDC").write_text(f"dummy_udc.{self.number}\n")

    def unbind(self):
        (self.folder / "UDC").write_text("\n")

    def path(self):
        """Returns the terminal of this device on the host's side, or None."""
        for tty_path in pathlib.Path("/sys/class/tty").glob("ttyACM*"):
            bus = os.path.realpath(tty_path / "device")
            if f"dummy_hcd.{self.number}/" in bus:
                return f"/dev/{tty_path.name}"
        return None


class Sensor(Gadget):
    """An emulated sensor behind a gadget."""

    def __init__(self, number, serial_number):
        super().__init__(number)
        self.serial_number = serial_number
        self.sent, self.partial = [], b""
        self.moment, self.plugged, self.hung = None, False, False
        self.emulator = None
        threading.Thread(target=self._work, daemon=True).start()

    def plug(self):
        """Gives the sensor power and a host. A sensor that gets power starts anew."""
        self.emulator = subprocess.Popen(
            [PROGRAM, "emulate", "--tcp", "0", "--serial-number", self.serial_number, "--seed",
             str(self.number)],
            stderr=subprocess.PIPE, text=True,
        )
        address = None
        while address is None:
            line = self.emulator.stderr.readline()
            expect(line, "the emulator has ended")
            found = re.search(r"tcp://([\d.]+):(\d+)", line)
            address = found and (found[1], int(found[2]))
        threading.Thread(target=self.emulator.stderr.read, daemon=True).start()
        self.line = socket.create_connection(address)
        self.partial, self.plugged = b"", True
        self.bind()

    def unplug(self):
        self.plugged = False
        self.unbind()
        self.line.close()
        self.emulator.kill()
        self.emulator.wait()

    def hang(self):
        """Hangs the firmware: the sensor takes no more bytes, and sends none."""
        self.hung = True
        time.sleep(0.3)
        # The controller has 16 buffers, which nobody reads now.
        host = hang_on(self.path())
        try:
            for _ in range(40):
                os.write(host, b"\n")
                time.sleep(0.02)
        except BlockingIOError:
            pass
        os.close(host)

    def recover(self):
        self.hung = False

    def unplug_at(self, moment):
        """Unplugs in the middle of a `reply`, of a `pause` (after a command, before its
        reply) or when `idle` (after a reply). Returns once it is unplugged."""
        done = threading.Event()
        self.moment = (moment, done)
        expect(done.wait(PATIENCE), f"no {moment} to unplug in within {PATIENCE} s")

    def _is_moment(self, name):
        if self.moment and self.moment[0] == name:
            done, self.moment = self.moment[1], None
            self.unplug()
            done.set()
            return True
        return False

    def _work(self):
        """Passes bytes between the emulator and the gadget, whenever there is a cable."""
        while True:
            if not self.plugged or self.hung:
                time.sleep(0.01)
                continue
            try:
                near = os.open(self.near, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                tty.setraw(near)
                termios.tcflush(near, termios.TCIOFLUSH)
                self._pass_on(near, self.line)
            except (OSError, termios.error, ValueError):
                time.sleep(0.01)
            finally:
                try:
                    os.close(near)
                except (OSError, UnboundLocalError):
                    pass

    def _pass_on(self, near, line):
        while self.plugged and line is self.line and not self.hung:
            ready, _, _ = select.select([near, line], [], [], 0.1)
            if near in ready:
                command = os.read(near, 256)
                if not command:
                    return
                if b"G" in command and self._is_moment("pause"):
                    return
                line.sendall(command)
            if line in ready:
                data = line.recv(4096)
                if not data:
                    return
                # In parts of USB's size, so that a cable can be pulled between two.
                for at in range(0, len(data), 64):
                    # Kept first: the program may print a scan before `_send` returns.
                    self._keep(data[at:at + 64])
                    self._send(near, data[at:at + 64])
                    is_half = self.partial.startswith(b"G") and len(self.partial) > 600
                    if is_half and self._is_moment("reply"):
                        return
                if not self.partial and self._is_moment("idle"):
                    return

    @staticmethod
    def _send(near, data):
        while data:
            try:
                data = data[os.write(near, data):]
            except BlockingIOError:
                select.select([], [near], [], 0.1)

    def _keep(self, data):
        self.partial += data
        while b"\n\n" in self.partial:
            reply, self.partial = self.partial.split(b"\n\n", 1)
            scan = decode(reply)
            if scan:
                self.sent.append(scan)

    def is_true(self, scan):
        """Returns whether a scan is part of a reply that passed the cable. The driver
        requests a few steps more than it delivers."""
        values = scan["values"]
        parts = (sent[scan["start"] - first:][:len(values)] for first, sent in self.sent)
        return any(part == values for part in parts)


def hang_on(path):
    """Opens a terminal and keeps it open, as a program does that does not notice the end."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    return fd
