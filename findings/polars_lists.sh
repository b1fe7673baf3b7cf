#!/usr/bin/env bash
# polars 2.1.0 (PyPI) silently reads the numbers of a list as null if the list was empty in the first 100 lines.
#
# Such a list names what only some scans have, such as the values beyond the range. Expected of `read_ndjson`, which
# takes the types from the first 100 lines: the numbers, or the error that a single number gets after 100 times null,
# "got non-null value for NULL-typed column". But each number in a list becomes null, and the length of the list stays
# right. A field that comes later is lost, too: an event in a log of scans becomes a row of null. With
# `infer_schema_length=None` it reads both.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json

from place import PLACE, compare, pypi

pypi("polars==2.1.0")
import polars  # noqa: E402


def last(first, then, **options):
    """Reads 100 lines with the value `first` and one with `then`, and an event. Returns this value and the event."""
    path = PLACE / "scans.ndjson"
    lines = [json.dumps({"value": value}) for value in [first] * 100 + [then]]
    path.write_text("\n".join([*lines, json.dumps({"event": "error"})]))
    try:
        *_, value, event = polars.read_ndjson(path, **options).rows(named=True)
        return value["value"], event
    except polars.exceptions.PolarsError as error:
        return type(error).__name__


LOST = {"value": None}
compare({
    "a number after null": last(None, 65533),
    "a number after numbers": last(7, 65533),
    "a list after empty ones": last([], [65533, 7]),
    "a list of two after lists of null": last([None, None], [1.5, 2.5]),
    "with all lines for the types": last([], [65533, 7], infer_schema_length=None),
}, {
    "a number after null": "ComputeError",
    "a number after numbers": (65533, LOST),
    "a list after empty ones": ([None, None], LOST),
    "a list of two after lists of null": ([None, None], LOST),
    "with all lines for the types": ([65533, 7], {"value": None, "event": "error"}),
})
END
