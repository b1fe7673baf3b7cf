#!/usr/bin/env bash
# polars 2.1.0 (PyPI) silently reads the numbers of a list as null if the list was empty in the first 100 lines.
#
# Such a list names what only some scans have, such as the values beyond the range. Expected of `read_ndjson`, which
# takes the types from the first 100 lines: the numbers, or the error that a single number gets after 100 times null,
# "got non-null value for NULL-typed column". But each number in a list becomes null, and the length of the list stays
# right. With `infer_schema_length=None` it reads them.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json

from place import PLACE, compare, pypi

pypi("polars==2.1.0")
import polars  # noqa: E402


def last(first, then, **options):
    """Reads 100 lines with the value `first` and one with `then`. Returns the last value as read."""
    path = PLACE / "scans.ndjson"
    path.write_text("".join(json.dumps({"value": value}) + "\n" for value in [first] * 100 + [then]))
    try:
        return polars.read_ndjson(path, **options)["value"].to_list()[-1]
    except polars.exceptions.PolarsError as error:
        return type(error).__name__


seen = {
    "a number after null": last(None, 65533),
    "a list after empty ones": last([], [65533, 7]),
    "a list of two after lists of null": last([None, None], [1.5, 2.5]),
    "with all lines for the types": last([], [65533, 7], infer_schema_length=None),
}
compare(seen, {
    "a number after null": "ComputeError",
    "a list after empty ones": [None, None],
    "a list of two after lists of null": [None, None],
    "with all lines for the types": [65533, 7],
})
END
