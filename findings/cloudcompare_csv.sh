#!/usr/bin/env bash
# CloudCompare 2.11.3 (Debian 12) reads no point of a CSV in which a column is empty for most points.
#
# Here `code` tells why a point is missing, and is empty for the others. Expected of its command line: the columns that
# the header names x and y, for 90 of 100 rows. But it skips empty fields, so that these rows have a column less than it
# expects. It saves a cloud without points, and exits with 0. Nor does it heed the header: it takes the first columns
# for x, y and z, and a time for a coordinate, which it rounds to 128 s. With x and y alone, all is well.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess

from place import PLACE, compare, debian

QT = "5.15.8+dfsg-11+deb12u3"
parts = ["concurrent5", "core5a", "gui5", "opengl5", "printsupport5", "widgets5"]
root = debian("cloudcompare=2.11.3-7.1", "libmd4c0=0.4.8-1", "libpcre2-16-0=10.42-1+deb12u2",
              *(f"libqt5{part}={QT}" for part in parts))
libraries = os.environ["LD_LIBRARY_PATH"]
os.environ.update({
    "HOME": str(PLACE),
    "LD_LIBRARY_PATH": f"{libraries}:{libraries}/cloudcompare",
    "QT_PLUGIN_PATH": f"{libraries}/qt5/plugins",
    "QT_QPA_PLATFORM": "offscreen",
})


def points(header, point, missing):
    """Exit status, number of points that it reads, and the first one."""
    place = PLACE / header
    place.mkdir()
    rows = [missing if number % 10 == 9 else point.format(x=1 + number / 10) for number in range(100)]
    (place / "scan.csv").write_text("\n".join([header, *rows, ""]))
    convert = ["-SILENT", "-AUTO_SAVE", "OFF", "-NO_TIMESTAMP", "-C_EXPORT_FMT", "ASC", "-PREC", "1"]
    run = subprocess.run([root / "usr/bin/CloudCompare", *convert, "-O", "scan.csv", "-SAVE_CLOUDS"], cwd=place,
                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    lines = next(place.glob("*.asc")).read_text().splitlines()
    return run.returncode, len(lines), *lines[:1]


seen = {
    "x, y": points("x,y", "{x},2", ","),
    "x, y, code": points("x,y,code", "{x},2,", ",,3"),
    "code, x, y": points("code,x,y", ",{x},2", "3,,"),
    "time, x, y": points("time,x,y", "1795962077.2,{x},2", "1795962077.2,,"),
}
compare(seen, {
    "x, y": (0, 90, "1.0 2.0 0.0"),
    "x, y, code": (0, 0),
    "code, x, y": (0, 0),
    "time, x, y": (0, 90, "1795962112.0 1.0 2.0"),
})
END
