#!/usr/bin/env bash
# DuckDB 2.0.1 (PyPI) silently reads a value of NDJSON as NULL if its field was null in the first 20,480 lines.
#
# These lines give the types. A field that is null in all of them is JSON up to 1.5.6, so that it can hold whatever
# comes later (issue 17126). Expected of 2.0.1: the value, or an error. But the column gets the type NULL, and a later
# number, text or object is lost. The same goes for a list of numbers. Such a column also hides what is an error without
# it, a field that first comes later, as events do in a log of scans. With `sample_size=-1` it reads all.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json

from place import PLACE, compare, pypi

pypi("duckdb==2.0.1")
import duckdb  # noqa: E402

PATH = PLACE / "scans.ndjson"


def last(first, then, lines=20_480, options=""):
    """Reads `lines` times `first`, then another object. Returns its fields as read."""
    PATH.write_text((json.dumps(first) + "\n") * lines + json.dumps(then) + "\n")
    try:
        query = duckdb.sql(f"SELECT * FROM read_json('{PATH}'{options}) OFFSET {lines}")
        return dict(zip(query.columns, query.fetchall()[0]))
    except duckdb.Error as error:
        return type(error).__name__


NULL, NUMBER = {"late": None}, {"late": 0.5}
compare({
    "a number within the first lines": last(NULL, NUMBER, lines=20_479),
    "a number after them": last(NULL, NUMBER),
    "a text after them": last(NULL, {"late": "text"}),
    "a list after lists of null": last({"ranges": [None, None]}, {"ranges": [1.5, 2.5]}),
    "a new field after them": last(NULL, {"event": "error"}),
    "a new field after numbers": last(NUMBER, {"event": "error"}),
    "with all lines for the types": last(NULL, NUMBER, options=", sample_size=-1"),
}, {
    "a number within the first lines": {"late": 0.5},
    "a number after them": {"late": None},
    "a text after them": {"late": None},
    "a list after lists of null": {"ranges": [None, None]},
    "a new field after them": {"late": None},
    "a new field after numbers": "InvalidInputException",
    "with all lines for the types": {"late": 0.5},
})
END
