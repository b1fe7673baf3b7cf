#!/usr/bin/env bash
# mcap-mcp-server 0.5.1 (PyPI), SQL over recordings: `downsample: 2` of two scanners keeps one, and loses the other.
#
# Their scans alternate in the file, as at equal rates. Expected of `load_recording` with `downsample`: every second
# scan of each topic. It counts the messages of all topics together, so one topic keeps all its scans, and the other has
# no table. Its report lists the table that there is, and no topic that was skipped. With 4, the one topic has every
# second scan. Load one topic at a time.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import asyncio
import json
import logging

from place import PLACE, compare, pypi

logging.disable()  # Decoders that are not installed.
pypi("mcap-mcp-server==0.5.1", "mcp==1.30.0", "mcap==1.6.0", "duckdb==2.0.1", "pandas==3.1.1")
from mcap.writer import Writer  # noqa: E402
from mcap_mcp_server.config import ServerConfig  # noqa: E402
from mcap_mcp_server.server import create_server  # noqa: E402

with open(PLACE / "run.mcap", "wb") as file:
    writer = Writer(file)
    writer.start()
    fields = {"nearest": {"type": "number"}}
    schema = writer.register_schema("Scan", "jsonschema", json.dumps({"type": "object", "properties": fields}).encode())
    channels = [writer.register_channel(topic, "json", schema) for topic in ["/front/scan", "/rear/scan"]]
    for number in range(100):
        for place, channel in enumerate(channels):
            time = 1_700_000_000_000_000_000 + number * 100_000_000 + place * 20_000_000
            writer.add_message(channel, time, b'{"nearest": 1.5}', time)
    writer.finish()


def rows(**options):
    """Returns the number of rows of each table, and the topics that are said to be skipped."""
    server = create_server(ServerConfig(data_dir=PLACE))
    content = asyncio.run(server.call_tool("load_recording", {"file": "run.mcap", **options}))
    report = json.loads((content[0] if isinstance(content, tuple) else content)[0].text)
    return {name: table["rows"] for name, table in report["tables"].items()}, report["skipped_topics"]


seen = {
    "all": rows(),
    "downsample: 2": rows(downsample=2),
    "downsample: 4": rows(downsample=4),
    "downsample: 2, one topic": rows(downsample=2, topics=["/front/scan"]),
}
compare(seen, {
    "all": ({"front_scan": 100, "rear_scan": 100}, []),
    "downsample: 2": ({"rear_scan": 100}, []),
    "downsample: 4": ({"rear_scan": 50}, []),
    "downsample: 2, one topic": ({"front_scan": 50}, []),
})
END
