"""Writes frames of TUIO 1.1: cursors at x, 0.5 that stand still."""

import struct


def messages(number, cursors, source="tracker@127.0.0.1"):
    """The messages of a frame. `cursors` has x by session id, or None if it has not changed."""
    sets = [["set", key, x, 0.5, 0.0, 0.0, 0.0] for key, x in cursors.items() if x is not None]
    return [["source", source], ["alive", *cursors], *sets, ["fseq", number]]


def text(value):
    value = value.encode()
    return value + bytes(4 - len(value) % 4)


def element(value):
    """Type tag and bytes."""
    if isinstance(value, str):
        return "s", text(value)
    return ("i", struct.pack(">i", value)) if isinstance(value, int) else ("f", struct.pack(">f", value))


def packet(*frame):
    """The frame as an OSC bundle."""
    bundle = text("#bundle") + struct.pack(">Q", 1)
    for arguments in messages(*frame):
        tags, values = zip(*map(element, arguments))
        message = text("/tuio/2Dcur") + text("," + "".join(tags)) + b"".join(values)
        bundle += struct.pack(">I", len(message)) + message
    return bundle
