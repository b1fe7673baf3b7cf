#!/usr/bin/env bash
# A reader with Fast DDS's `maxMessageSize` at 1472 silently loses every larger packet that others send (ROS 2 Jazzy).
#
# It is set for Wi-Fi, so that each packet fits into a frame. Expected: it limits what this program sends. It is the
# size of the receive buffer, too, and the rest of a packet is cut off (issue 2690, open since 2022). So of reliable
# texts of 8,700 bytes, which another Fast DDS sends with its defaults, none arrives, although the publisher is listed.
# The property `fastdds.max_message_size` limits only what is sent. All packages are from PyPI.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess

from place import PLACE, compare, network, ros, run

WRITER = """
import time
import rclpy
from std_msgs.msg import String
rclpy.init()
publisher = rclpy.create_node("writer").create_publisher(String, "text", 10)
while True:
    publisher.publish(String(data="x" * 8700))
    time.sleep(0.1)
"""
READER = """
import os
import time
import rclpy
from std_msgs.msg import String
rclpy.init()
node, texts = rclpy.create_node("reader"), []
node.create_subscription(String, "text", texts.append, 10)
end = time.monotonic() + 10
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
print(bool(texts), node.count_publishers("text"), flush=True)
os._exit(0)
"""
PROFILES = {
    "no limit": "",
    "maxMessageSize": """<useBuiltinTransports>false</useBuiltinTransports>
        <userTransports><transport_id>udp</transport_id></userTransports>""",
    "fastdds.max_message_size": """<propertiesPolicy><properties><property>
        <name>fastdds.max_message_size</name><value>1472</value></property></properties></propertiesPolicy>""",
}
python = ros("ros-jazzy-rclpy==7.1.6", "ros-jazzy-std-msgs==5.3.6", "ros-jazzy-rmw-fastrtps-cpp==8.4.3")
# As between two hosts: no shared memory.
os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
network()
run(python, "-c", WRITER)
seen = {}
for name, settings in PROFILES.items():
    (PLACE / "profile.xml").write_text(f"""<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
        <transport_descriptors><transport_descriptor>
        <transport_id>udp</transport_id><type>UDPv4</type><maxMessageSize>1472</maxMessageSize>
        </transport_descriptor></transport_descriptors>
        <participant profile_name="all" is_default_profile="true"><rtps>{settings}</rtps></participant></profiles>""")
    reader = subprocess.run([python, "-c", READER], stdout=subprocess.PIPE, text=True, check=True, timeout=60,
                            env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(PLACE / "profile.xml")})
    receives, publishers = reader.stdout.split()
    seen[name] = f"receives: {receives}, publishers: {publishers}"
compare(seen, {
    "no limit": "receives: True, publishers: 1",
    "maxMessageSize": "receives: False, publishers: 1",
    "fastdds.max_message_size": "receives: True, publishers: 1",
})
END
