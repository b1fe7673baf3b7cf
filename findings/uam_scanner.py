"""A UAM-05LP that answers the two commands of the scripts, in frames as the package uam-05lp reads them."""

from uam_05lp import _crc

VERSION = "UAM-05LP".ljust(30) + "1.0.0".ljust(68) + "H0000001"


def reply(command, distance):
    """The reply to `VR00`, or to `AR00`: nothing detected, and 1,081 equal distances."""
    data = VERSION if command == "VR00" else "0" * 39 + f"{distance:04X}" * 1081
    body = f"{len(data) + 16:04X}{command}00{data}"
    return f"\2{body}{_crc.compute_crc(body.encode()):04X}\3".encode()


def answer(read, write):
    """Answers each command as soon as it has come. Distances count the commands."""
    received, number = b"", 0
    while chunk := read(4096):
        *commands, received = (received + chunk).split(b"\3")
        for command in commands:
            number += 1
            write(reply(command[5:9].decode(), number), number)
