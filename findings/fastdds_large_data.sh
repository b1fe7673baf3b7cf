#!/usr/bin/env bash
# ROS 2 Jazzy with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA hears only programs that have it, too (rmw_fastrtps_cpp 8.4.3).
#
# It is advised for images and point clouds: UDP finds others, then TCP or shared memory carries the data. Expected: on
# one host it hears any program with Fast DDS, which has shared memory, too, and Cyclone DDS (11.0.1) over UDP. It hears
# neither: nodes are not listed, topics have no publisher, and no log says why. All packages are from PyPI.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess

from cyclone_writer import cyclone_writer
from place import compare, network, ros, run

WRITERS = {
    "Fast DDS": """
import rclpy
from std_msgs.msg import String
rclpy.init()
publisher = rclpy.create_node("writer").create_publisher(String, "text", 10)
def write(): publisher.publish(String(data="hello"))
""",
    "Cyclone DDS": cyclone_writer(7, "rt/text", "std_msgs::msg::dds_::String_"),
}
READER = """
import os
import time
import rclpy
from std_msgs.msg import String
rclpy.init()
node, texts = rclpy.create_node("reader"), []
node.create_subscription(String, "text", texts.append, 10)
end = time.monotonic() + 10
while time.monotonic() < end and not texts:
    rclpy.spin_once(node, timeout_sec=0.1)
print(bool(texts), node.count_publishers("text"), flush=True)
os._exit(0)
"""
python = ros("ros-jazzy-rclpy==7.1.6", "ros-jazzy-std-msgs==5.3.6", "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
             "cyclonedds==11.0.1")
network()
seen = {}
for writer, transports in [("Fast DDS", "LARGE_DATA"), ("Fast DDS", "DEFAULT"), ("Cyclone DDS", "DEFAULT")]:
    program = WRITERS[writer] + "\nimport time\nwhile True:\n    write()\n    time.sleep(0.1)\n"
    process = run(python, "-c", program, env={**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": transports})
    for own in ["DEFAULT", "LARGE_DATA"]:
        reader = subprocess.run([python, "-c", READER], stdout=subprocess.PIPE, text=True, check=True,
                                env={**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": own})
        hears, publishers = reader.stdout.split()
        seen[f"{own} of {writer} with {transports}"] = f"hears: {hears}, publishers: {publishers}"
    process.kill()
    process.wait()
# Removes what killed programs have left in shared memory.
subprocess.run([python.with_name("fastdds"), "shm", "clean"], stdout=subprocess.DEVNULL, check=True)
compare(seen, {
    "DEFAULT of Fast DDS with LARGE_DATA": "hears: False, publishers: 0",
    "LARGE_DATA of Fast DDS with LARGE_DATA": "hears: True, publishers: 1",
    "DEFAULT of Fast DDS with DEFAULT": "hears: True, publishers: 1",
    "LARGE_DATA of Fast DDS with DEFAULT": "hears: False, publishers: 0",
    "DEFAULT of Cyclone DDS with DEFAULT": "hears: True, publishers: 1",
    "LARGE_DATA of Cyclone DDS with DEFAULT": "hears: False, publishers: 0",
})
END
