# mcap-bag-parser 0.3.1 (PyPI) leaves long arrays out of its data frame without a word: a LaserScan has no ranges.
#
# Expected: a column for each range, as there are for a short scan, or an error. An array of up to 100 values gets its
# columns. A longer one gets none, and the rest of the message looks complete.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import contextlib
import io

from place import PLACE, compare, pypi

pypi("mcap-bag-parser==0.3.1", "mcap-ros2-support==0.6.0", "mcap==1.6.0")
from mcap_bag import parse_mcap_file  # noqa: E402
from mcap_ros2.writer import Writer  # noqa: E402

seen = {}
for length in [99, 100, 101, 682]:
    path = str(PLACE / f"{length}.mcap")
    with open(path, "wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/LaserScan", "float32 angle_min\nfloat32[] ranges")
        writer.write_message("/scan", schema, {"angle_min": 0.5, "ranges": [1.0] * length}, log_time=1, publish_time=1)
        writer.finish()
    with contextlib.redirect_stdout(io.StringIO()):
        frame = parse_mcap_file(path)["/scan"]
    columns = sum("ranges" in column for column in frame.columns)
    seen[f"{length} ranges"] = {"rows": len(frame), "columns of ranges": columns}
compare(seen, {
    "99 ranges": {"rows": 1, "columns of ranges": 99},
    "100 ranges": {"rows": 1, "columns of ranges": 100},
    "101 ranges": {"rows": 1, "columns of ranges": 0},
    "682 ranges": {"rows": 1, "columns of ranges": 0},
})
END
