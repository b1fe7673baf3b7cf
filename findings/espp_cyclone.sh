# espp 1.3.10 (PyPI), embeddedRTPS for ESP32, gets no message of Cyclone DDS 11.0.1 (PyPI).
#
# It is "for pub/sub interop with FastDDS and ROS 2", and does read a topic of rclpy (Jazzy) over Fast DDS. Expected: of
# Cyclone DDS, ROS 2's other engine, too, since both speak RTPS. Cyclone DDS finds its first packets malformed,
# but learns of its reader, and sends to it. espp gets nothing, and says nothing.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess
import sys
import time

from cyclone_writer import cyclone_writer
from place import PLACE, compare, network, pypi, run

WRITERS = {
    "espp": """
import espp
participant = espp.RtpsParticipant(espp.RtpsParticipant.Config(interface_address="10.0.0.1"))
participant.start()
participant.add_writer("text", "Text", reliable=True)
def write(): participant.publish("text", b"\\0\\1\\0\\0\\6\\0\\0\\0hello\\0\\0\\0")
""",
    "Cyclone DDS": cyclone_writer(0, "text", "Text"),
}
os.environ["PYTHONPATH"] = str(pypi("espp==1.3.10", "cyclonedds==11.0.1"))
network()
import espp  # noqa: E402

seen = {}
for name, writer in WRITERS.items():
    program = writer + "\nimport time\nwhile True:\n    write()\n    time.sleep(0.1)\n"
    with open(PLACE / "log", "wb") as log:
        process = run(sys.executable, "-c", program, stdout=subprocess.DEVNULL, stderr=log)
    received = []
    config = espp.RtpsParticipant.Config(interface_address="10.0.0.1")
    reader = espp.RtpsParticipant(config)
    reader.start()
    reader.add_reader("text", "Text", reliable=True, on_sample=received.append)
    time.sleep(10)
    reader.stop()
    process.kill()
    process.wait()
    is_malformed = b"malformed packet received from vendor 13.37" in (PLACE / "log").read_bytes()
    seen[name] = {"received": bool(received), "finds packets malformed": is_malformed}
compare(seen, {
    "espp": {"received": True, "finds packets malformed": False},
    "Cyclone DDS": {"received": False, "finds packets malformed": True},
})
END
