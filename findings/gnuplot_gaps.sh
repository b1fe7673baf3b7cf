#!/usr/bin/env bash
# gnuplot 5.4.4 (Debian 12) draws a line across points whose distance is empty: an open door looks like a wall.
#
# Expected of an empty field of CSV: a gap in the line, as a NaN in the file makes, at least if an expression turns it
# into NaN. gnuplot leaves out the row, and joins its neighbours. A `$2` in the expression does that even in a branch
# not taken; `column(2)` does not.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import re
import subprocess

from place import PLACE, compare, debian

# Angle, range, x and y: a wall, a door, and a wall.
ROWS = [(-0.5, 2, 2, -1), (-0.3, 2, 2, -0.6), (0, "", "", ""), (0.3, 2, 2, 0.6), (0.5, 2, 2, 1)]


def lines(using, file="empty.csv"):
    """Returns how many lines it draws for these columns."""
    commands = f"set datafile separator ','; set terminal svg; unset border; unset tics; plot '{file}' using {using} " \
        "with lines notitle"
    drawn = subprocess.run(["gnuplot-nox", "-e", commands], cwd=PLACE, capture_output=True, text=True, check=True)
    curve = drawn.stdout.split('id="gnuplot_plot_1"')[1].split("</g>")[0]
    return len(re.findall(r"\bM[0-9]", curve))


debian("gnuplot-nox=5.4.4+dfsg1-2+b2", "liblua5.4-0=5.4.4-3+deb12u1")
for name, empty in [("empty.csv", ""), ("nan.csv", "NaN")]:
    text = "\n".join(",".join(str(value if value != "" else empty) for value in row) for row in ROWS)
    (PLACE / name).write_text(text + "\n")
COLUMNS = ["1:2", "3:4", "1:($2)", "1:(valid(2) ? $2 : NaN)", "1:(strcol(2) eq '' ? NaN : $2)",
           "1:(valid(2) ? column(2) : NaN)", "(valid(3) ? column(3) : NaN):(valid(4) ? column(4) : NaN)"]
seen = {using: lines(using) for using in COLUMNS}
compare({**seen, "NaN in the file": lines("1:2", "nan.csv")}, {
    "1:2": 1,
    "3:4": 1,
    "1:($2)": 1,
    "1:(valid(2) ? $2 : NaN)": 1,
    "1:(strcol(2) eq '' ? NaN : $2)": 1,
    "1:(valid(2) ? column(2) : NaN)": 2,
    "(valid(3) ? column(3) : NaN):(valid(4) ? column(4) : NaN)": 2,
    "NaN in the file": 2,
})
END
