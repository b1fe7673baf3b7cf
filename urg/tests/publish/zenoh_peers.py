"""Reads what `urg publish --engine zenoh` publishes: with zenoh itself, and with pyzeros.

zenoh_peers.py PROGRAM RECORDING
"""

import json
import os
import struct
import subprocess
import sys
import time

import zenoh

from common import RECORDING, Urg, compare, ok, wait

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", '["tcp/localhost:7447"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("ready", flush=True)
time.sleep(3600)
"""
DOMAIN = os.environ["ROS_DOMAIN_ID"]
SCAN = "sensor_msgs::msg::dds_::LaserScan_/RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
TF_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def start_router():
    router = subprocess.Popen([sys.executable, "-c", ROUTER], stdout=subprocess.PIPE, text=True)
    assert router.stdout.readline() == "ready\n"
    return router


def stop(process):
    process.kill()
    process.wait()


def open_session(mode="client"):
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("connect/endpoints", '["tcp/localhost:7447"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def decode(payload):
    """Decodes a LaserScan: its stamp and its ranges."""
    assert payload[:4] == b"\0\1\0\0"
    body = payload[4:]
    sec, nanosec, length = struct.unpack_from("<iII", body)
    at = 12 + length
    at += -at % 4 + 7 * 4
    (count,) = struct.unpack_from("<I", body, at)
    ranges = struct.unpack_from(f"<{count}f", body, at + 4)
    at += 4 + 4 * count
    assert struct.unpack_from("<I", body, at) == (0,) and len(body) == at + 4
    return sec * 1_000_000_000 + nanosec, list(ranges)


class Reader:
    def __init__(self, session, topic):
        self.got = []
        self.subscriber = session.declare_subscriber(f"{DOMAIN}/{topic}/{SCAN}", self.take)

    def take(self, sample):
        self.got.append((decode(bytes(sample.payload)), bytes(sample.attachment)))

    def close(self):
        self.subscriber.undeclare()


def values_are_the_same(session):
    for mode in ("client", "peer"):
        reader = Reader(session, "scan")
        with Urg("publish", RECORDING, "--engine", "zenoh", "--mode", mode) as urg:
            urg.wait()
        wait("the last scan", lambda: len(reader.got) > 20)
        time.sleep(0.3)
        compare(f"zenoh, {mode}", [scan for scan, _ in reader.got])
        metadata = [struct.unpack("<qqB16s", attachment) for _, attachment in reader.got]
        numbers = [number for number, *_ in metadata]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), numbers
        assert {(length, gid) for _, _, length, gid in metadata} == {(16, metadata[0][3])}
        assert all(abs(t - time.time_ns()) < 60e9 for _, t, _, _ in metadata)
        reader.close()
    ok("each message has rmw_zenoh's metadata")


def the_graph(session):
    tokens = set()

    def change(sample):
        key = str(sample.key_expr)
        tokens.add(key) if sample.kind == zenoh.SampleKind.PUT else tokens.discard(key)

    subscriber = session.liveliness().declare_subscriber(f"@ros2_lv/{DOMAIN}/**", change, history=True)
    options = ["--engine", "zenoh", "--qos", "sensor", "--namespace", "/robot"]
    with Urg("publish", "front=emulated", "rear=emulated", *options) as urg:
        wait("all tokens", lambda: len(tokens) == 6)
        parts = sorted(token.split("/")[3:] for token in tokens)
        assert parts[:3] == [
            ["0", "0", "NN", "%", "%robot%front", "urg_node"],
            ["0", "1", "MP", "%", "%robot%front", "urg_node", "%robot%front%scan", *SCAN.split("/"), "2::,5:,:,:,,"],
            ["0", "2", "MP", "%", "%robot%front", "urg_node", "%diagnostics",
             "diagnostic_msgs::msg::dds_::DiagnosticArray_",
             "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e", "::,10:,:,:,,"],
        ], parts
        said = urg.stop()
        started = "urg: scans are published on 2 topics, /robot/front/scan to /robot/rear/scan; Ctrl-C stops\n"
        assert said == started, f"a clean end is silent: {said}"
    wait("the graph is clean", lambda: not tokens)
    subscriber.undeclare()
    ok("the nodes are in the graph, and Ctrl-C takes them out, silently")


def the_router_goes_and_comes(session):
    # Away at the start: it waits and says so once.
    with Urg("publish", "emulated", "--engine", "zenoh") as urg:
        urg.wait_for("no zenoh router answers at tcp/localhost:7447")
        router = start_router()
        session = open_session()
        reader = Reader(session, "scan")
        wait("scans", lambda: len(reader.got) > 5)
        assert urg.read().count("no zenoh router") == 1, urg.said
        stop(router)
        wait("the loss", lambda: urg.read().count("no zenoh router") == 2)
        begin = len(reader.got)
        router = start_router()
        wait("scans again", lambda: len(reader.got) > begin + 5, 40)
        # What was measured in between is dropped: the next scan is a new one.
        age = time.time_ns() - reader.got[-1][0][0]
        assert age < 2e9, f"an old scan was kept: {age} ns"
        assert urg.read().count("network is back") == 2, urg.said
    ok("a router that is away is waited for, at the start and later")
    return router, session


def pyzeros_reads(session):
    import pyzeros
    from pyzeros.sub import RawSub
    from pyzeros.utils import rmw_zenoh_gid
    from ros2_pyterfaces.cydr.all_msgs import LaserScan

    node = pyzeros.Session("reader", zenoh_session=session, domain_id=DOMAIN)
    got, tokens = [], []
    sub = RawSub(msg_type=LaserScan, topic="scan", callback=got.append, session=node)
    watch = session.liveliness().declare_subscriber(
        f"@ros2_lv/{DOMAIN}/*/*/*/MP/**", lambda sample: tokens.append(str(sample.key_expr))
    )
    with Urg("publish", RECORDING, "--engine", "zenoh") as urg:
        urg.wait()
    wait("the last scan", lambda: len(got) > 20)
    time.sleep(0.3)
    # Its own decoder needs a C compiler.
    compare("pyzeros", [decode(sample.payload.to_bytes()) for sample in got])
    token = next(token for token in tokens if "%scan" in token)
    assert bytes(got[0].attachment)[17:] == rmw_zenoh_gid(token), "another identity"
    ok("the publisher has the identity that its token hashes to")
    sub.close()
    watch.undeclare()


def places_are_kept_for_late_readers(session):
    """As rmw_zenoh reads a topic that is transient local: with zenoh's advanced subscriber."""
    import zenoh.ext

    key = f"{DOMAIN}/tf_static/tf2_msgs::msg::dds_::TFMessage_/{TF_HASH}"
    scans = Reader(session, "scan")
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
    messages = []
    subscribe = lambda: zenoh.ext.declare_advanced_subscriber(
        session, key, messages.append, history=history
    )
    with Urg("publish", "emulated", "--engine", "zenoh", "--tf", "base,0.5,-1,2,180"):
        wait("scans", lambda: len(scans.got) > 5)
        late = subscribe()
        wait("the place", lambda: messages)
        payload = bytes(messages[0].payload)
        frames = struct.unpack_from("<I8xI5s3xI6s", payload, 4)
        assert frames == (1, 5, b"base\0", 6, b"laser\0"), frames
        numbers = struct.unpack("<7d", payload[-56:])
        assert numbers[:6] == (0.5, -1, 2, 0, 0, 1) and abs(numbers[6]) < 1e-15, numbers
        assert len(bytes(messages[0].attachment)) == 33
        late.undeclare()
    # A reader that is there before the publisher gets it, too.
    messages.clear()
    early = subscribe()
    with Urg("publish", "emulated", "--engine", "zenoh", "--tf", "base,0.5,-1,2,180"):
        wait("the place", lambda: messages)
    early.undeclare()
    scans.close()
    ok("the place of a sensor is kept for readers that come late")


router = start_router()
session = open_session()
values_are_the_same(session)
the_graph(session)
places_are_kept_for_late_readers(session)
pyzeros_reads(session)
session.close()
stop(router)
router, session = the_router_goes_and_comes(session)
stop(router)
os._exit(0)
