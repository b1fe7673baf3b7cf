"""Reads /metrics of `urg serve` with Prometheus' own client, and checks what it read.

    pip install prometheus_client
    curl -s http://127.0.0.1:8080/metrics | python3 tests/metrics.py front rear

The arguments are the names of the sensors; without one there is one sensor, without
a name.
"""

import sys

from prometheus_client.parser import text_string_to_metric_families

names = sys.argv[1:] or [None]
families = {family.name: family for family in text_string_to_metric_families(sys.stdin.read())}
assert families["urg_viewers"].type == "gauge", families["urg_viewers"]
for family, kind in [
    ("urg_up", "gauge"),
    ("urg_scan_age_seconds", "gauge"),
    ("urg_scan_rate_hertz", "gauge"),
    ("urg_scans", "counter"),
    ("urg_poll_failures", "counter"),
    ("urg_reply_latency_seconds", "summary"),
]:
    assert families[family].type == kind, families[family]
    assert families[family].documentation, family
    sensors = {sample.labels.get("sensor") for sample in families[family].samples}
    assert sensors == set(names), (family, sensors)
for sample in families["urg_up"].samples:
    assert sample.value == 1.0, sample
causes = {sample.labels["cause"] for sample in families["urg_poll_failures"].samples}
assert causes == {"timeout", "malformed", "refused"}, causes
latency = {sample.name for sample in families["urg_reply_latency_seconds"].samples}
quantiles, *sums = [f"urg_reply_latency_seconds{end}" for end in ("", "_sum", "_count")]
assert latency == {quantiles, *sums}, latency
print(f"{len(families)} metrics of {len(names)} sensors")
