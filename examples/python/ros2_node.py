"""A ROS 2 node from the lines of `urg stream`: urg stream PORT --wait | python3 ros2_node.py"""

import json, math, sys
import rclpy
from sensor_msgs.msg import LaserScan

rclpy.init()
node = rclpy.create_node("urg")
publisher = node.create_publisher(LaserScan, "scan", 10)
for line in sys.stdin:
    scan = json.loads(line)
    if "event" in scan:
        node.get_logger().warning(str(scan))
        continue
    message = LaserScan()
    message.header.frame_id = "laser"
    # ROS wants the time of the first ray.
    stamp = scan["first_ray"]
    message.header.stamp.sec = int(stamp)
    message.header.stamp.nanosec = int(stamp % 1 * 1e9)
    message.angle_min = scan["angle_min"]
    message.angle_increment = scan["angle_increment"]
    message.angle_max = scan["angle_min"] + (len(scan["ranges"]) - 1) * scan["angle_increment"]
    message.time_increment = scan["scan_time"] * scan["angle_increment"] / math.tau
    message.scan_time = scan["scan_time"]
    message.range_min, message.range_max = scan["range_min"], scan["range_max"]
    # REP 117: some of the values without a distance may be beyond the range, others are unknown.
    message.ranges = [
        r if r is not None else math.inf if v in scan["beyond"] else math.nan
        for r, v in zip(scan["ranges"], scan["values"])
    ]
    publisher.publish(message)
