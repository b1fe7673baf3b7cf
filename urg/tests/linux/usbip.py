"""USB devices in Python, behind the kernel's `vhci_hcd`: the far end of the usbip protocol.

The kernel sends each transfer through a socket: a header of 48 bytes, then the data. `Device` answers
the requests that every device knows; a subclass answers those of its chip and has the line."""

import pathlib
import socket
import struct
import threading

CONTROLLER = pathlib.Path("/sys/devices/platform/vhci_hcd.0")
SUBMIT, UNLINK = 1, 2
FULL_SPEED = 2
STALL, RESET = -32, -104
IN = 0x80


class Stall(Exception):
    """The device refuses a control request."""


class Device:
    """A full-speed device with one configuration and one interface. `endpoints` are (address, kind,
    bytes) with USB's kinds 2 (bulk) and 3 (interrupt)."""

    ids = (0, 0)
    release, usb_release = 0x0100, 0x0110
    configuration = 1
    # Manufacturer, product and serial number. None: it has no such text.
    texts = (None, None, None)
    endpoints = ()

    def __init__(self):
        self.lock = threading.Lock()
        self.socket = None
        self.input, self.waiting, self.held = bytearray(), {}, False

    def plug(self, port=0):
        """Connects the device to a port of the controller."""
        self.socket, far = socket.socketpair()
        self.input.clear()
        self.waiting.clear()
        with far:
            (CONTROLLER / "attach").write_text(f"{port} {far.fileno()} {port + 1} {FULL_SPEED}")
        threading.Thread(target=self._serve, args=[self.socket], daemon=True).start()

    def unplug(self):
        self.socket.shutdown(socket.SHUT_RDWR)

    def hold(self, held):
        """Takes no bytes while `held`."""
        with self.lock:
            self.held = held
            self._take()

    def receive(self, data):
        """Passes bytes from the line to the host."""
        with self.lock:
            self.input += data
            try:
                self._give()
            except OSError:
                pass  # unplugged

    def control(self, kind, request, value, index, data, length):
        """Answers a control request: returns bytes, or raises `Stall`."""
        raise Stall

    def write(self, data):
        """Sends bytes of the host on the line."""

    def _serve(self, near):
        try:
            while True:
                command, number, _, is_in, endpoint, first, length = struct.unpack(
                    ">7I12x", self._exactly(near, 40))
                setup = self._exactly(near, 8)
                has_data = command == SUBMIT and not is_in
                data = self._exactly(near, length) if has_data else b""
                with self.lock:
                    if command == UNLINK:
                        # `first` is the number of the transfer that the host takes back.
                        taken_back = self.waiting.pop(first, None)
                        near.sendall(struct.pack(">5Ii24x", 4, number, 0, 0, 0, RESET if taken_back else 0))
                    elif endpoint == 0:
                        self._control(near, number, is_in, setup, data)
                    else:
                        self.waiting[number] = (near, endpoint | (IN if is_in else 0), length, data)
                        self._give()
                        self._take()
        except OSError:
            pass

    def _control(self, near, number, is_in, setup, data):
        kind, request, value, index, length = struct.unpack("<BBHHH", setup)
        try:
            if kind & 0x60 == 0:
                answer = self._standard(request, value)
            else:
                answer = self.control(kind, request, value, index, data, length)
            self._complete(near, number, (answer or b"")[:length] if is_in else data, is_in)
        except Stall:
            self._complete(near, number, b"", is_in, STALL)

    def _standard(self, request, value):
        if request != 6:  # get descriptor
            return bytes(2)
        kind, which = value >> 8, value & 0xff
        if kind == 1:
            numbers = [n + 1 if text else 0 for n, text in enumerate(self.texts)]
            return struct.pack("<BBHBBBBHHHBBBB", 18, 1, self.usb_release, 0, 0, 0, 64, *self.ids,
                               self.release, *numbers, 1)
        if kind == 2:
            parts = b"".join(struct.pack("<BBBBHB", 7, 5, *endpoint, 1) for endpoint in self.endpoints)
            interface = struct.pack("<9B", 9, 4, 0, 0, len(self.endpoints), 0xff, 0, 0, 0)
            total = 9 + len(interface) + len(parts)
            return struct.pack("<BBHBBBBB", 9, 2, total, 1, self.configuration, 0, 0x80, 50) + interface + parts
        if kind == 3:
            text = b"\x09\x04" if which == 0 else (self.texts[which - 1] or "").encode("utf-16-le")
            return bytes([len(text) + 2, 3]) + text
        raise Stall

    def _complete(self, near, number, data, is_in, status=0):
        header = struct.pack(">5IiI20x", 3, number, 0, 0, 0, status, len(data))
        near.sendall(header + (data if is_in else b""))

    def _give(self):
        """Completes transfers that wait for bytes of the line."""
        for number, (near, address, length, _) in list(self.waiting.items()):
            if self.input and address == self.bulk(IN):
                data, self.input = bytes(self.input[:length]), self.input[length:]
                del self.waiting[number]
                self._complete(near, number, data, True)

    def _take(self):
        """Completes transfers that bring bytes of the host."""
        for number, (near, address, _, data) in list(self.waiting.items()):
            if address == self.bulk(0) and not self.held:
                del self.waiting[number]
                self.write(data)
                self._complete(near, number, data, False)

    def bulk(self, direction):
        return next(address for address, kind, _ in self.endpoints if kind == 2 and address & IN == direction)

    @staticmethod
    def _exactly(near, length):
        data = b""
        while len(data) < length:
            part = near.recv(length - len(data))
            if not part:
                raise ConnectionError
            data += part
        return data
