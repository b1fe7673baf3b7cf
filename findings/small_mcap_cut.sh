#!/usr/bin/env bash
# small-mcap 0.16.0 (PyPI) reads a file that is cut off without a word, and cannot recover one that mcap wrote.
#
# A recorder that lost its power leaves a file without its end. Its README has an option for such files. Expected
# without it: an error, as of mcap 1.6.0 (PyPI); with `recover=True`: all whole chunks. But without it the messages end
# at the cut, as if there were no more. With it, a file of mcap's writer, which has its channels in the chunks alone, as
# the format permits, yields no message: ChannelNotFoundError. A file of its own writer is recovered.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
from place import PLACE, compare, pypi

pypi("small-mcap==0.16.0", "mcap==1.6.0")
import mcap.writer  # noqa: E402
import small_mcap  # noqa: E402
from mcap.reader import make_reader  # noqa: E402

MESSAGES = range(500)
DATA = b'{"range": 1.0}'
CHUNK = 2_000


def with_mcap(path):
    writer = mcap.writer.Writer(str(path), chunk_size=CHUNK, compression=mcap.writer.CompressionType.NONE)
    writer.start()
    schema = writer.register_schema("Scan", "jsonschema", b"{}")
    channel = writer.register_channel("/scan", "json", schema)
    for number in MESSAGES:
        writer.add_message(channel, number, DATA, number, number)
    writer.finish()


def with_small_mcap(path):
    with path.open("wb") as file:
        writer = small_mcap.McapWriter(file, chunk_size=CHUNK, compression=small_mcap.CompressionType.NONE)
        writer.start()
        writer.add_schema(1, "Scan", "jsonschema", b"{}")
        writer.add_channel(1, "/scan", "json", 1)
        for number in MESSAGES:
            writer.add_message(1, number, DATA, number, number)
        writer.finish()


def read(path, **options):
    """How many messages small-mcap yields, and the error that ends them."""
    count = 0
    try:
        with small_mcap.McapFile.open(path, **options) as file:
            for _ in file.read_message():
                count += 1
    except small_mcap.McapError as error:
        return count, type(error).__name__
    return count, None


def fails_in_mcap(path):
    with path.open("rb") as file:
        try:
            return not list(make_reader(file).iter_messages())
        except Exception:
            return True


seen, expected = {}, {}
for write in [with_mcap, with_small_mcap]:
    whole, cut = PLACE / "whole.mcap", PLACE / "cut.mcap"
    write(whole)
    data = whole.read_bytes()
    cut.write_bytes(data[:len(data) // 2])
    count, error = read(cut)
    seen[write.__name__] = {
        "whole": read(whole),
        "half of it": (100 < count < 400, error),
        "half of it, recover=True": read(cut, recover=True) == (count, None) or read(cut, recover=True),
        "half of it, mcap 1.6.0 fails": fails_in_mcap(cut),
    }
    expected[write.__name__] = {
        "whole": (len(MESSAGES), None),
        "half of it": (True, None),
        "half of it, recover=True": (0, "ChannelNotFoundError") if write is with_mcap else True,
        "half of it, mcap 1.6.0 fails": True,
    }
compare(seen, expected)
END
