"""Starts `urg publish` from the launch file of the guide, and with random arguments of ROS, of
which rclpy tells what they mean.

launch.py PROGRAM RECORDING [core] [SEED]. No package index has launch and launch_ros: stand-ins put
together the command line as launch_ros does.
"""

import os
import random
import re
import shutil
import sys
import tempfile
import types
from pathlib import Path

import rclpy
import yaml
from rclpy.context import Context
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan

from common import Urg, ok, wait

GUIDE = Path(__file__).resolve().parents[2] / "guide" / "publish.md"
FOLDER = Path(tempfile.mkdtemp())

rclpy.init()
observer = rclpy.create_node("observer")


def file_of(parameters):
    path = FOLDER / f"{len(list(FOLDER.iterdir()))}.yaml"
    path.write_text(yaml.dump(parameters, default_flow_style=False))
    return str(path)


class Node:
    """Stand-in for `launch_ros.actions.Node`."""

    def __init__(self, executable, arguments, name, namespace, remappings, parameters):
        self.command = [executable, *arguments, "--ros-args", "-r", f"__node:={name}"]
        self.command += ["-r", f"__ns:={namespace}"]
        for parameter in parameters:
            if isinstance(parameter, dict):
                values = {f"{namespace}/{name}": {"ros__parameters": parameter}}
                self.command += ["--params-file", file_of(values)]
            else:
                name_of, value = parameter
                self.command += ["-p", f"{name_of}:={yaml.dump(value)}"]
        for pair in remappings:
            self.command += ["-r", ":=".join(pair)]


def launched(text):
    """Returns the command line of the only node of a launch file."""
    modules = {
        "launch": {"LaunchDescription": lambda nodes: nodes},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "launch_ros.parameter_descriptions": {"Parameter": lambda *pair: pair},
    }
    for name, contents in modules.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update(contents)
    names = {}
    exec(text, names)
    (node,) = names["generate_launch_description"]()
    return node.command


def seen(arguments):
    """Runs `urg` with these arguments; returns topic, node and frame of its scans."""
    got = []
    with Urg(*arguments) as urg:
        urg.wait_for("scans are published on ")
        topic = re.search("published on (.*);", urg.said)[1]
        subscription = observer.create_subscription(LaserScan, topic, got.append, 10)
        spin = lambda: rclpy.spin_once(observer, timeout_sec=0.05)
        wait("a scan", lambda: got, 20, spin)
        node = lambda: [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in observer.get_publishers_info_by_topic(topic)
        ]
        wait("the node", lambda: node() and "UNKNOWN" not in node()[0], 20, spin)
        found = topic, node()[0], got[0].header.frame_id
        observer.destroy_subscription(subscription)
    return found


def meant(arguments):
    """Returns what the arguments mean for a node of ROS with the same defaults."""
    context = Context()
    rclpy.init(args=arguments, context=context)
    node = rclpy.create_node("urg_node", context=context, allow_undeclared_parameters=True)
    frame = node.declare_parameter("frame", "laser").value
    publisher = node.create_publisher(LaserScan, "scan", QoSProfile(depth=1))
    found = publisher.topic_name, node.get_fully_qualified_name(), frame
    node.destroy_node()
    context.shutdown()
    return found


def the_launch_file_of_the_guide():
    (text,) = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.S)
    _, *arguments = launched(text.replace('"/dev/ttyACM0"', '"emulated"'))
    expected = "/robot/front/scan", "/robot/front", "front_laser"
    assert seen(arguments) == expected, arguments
    ok("the launch file of the guide")


def random_arguments(chance):
    """Returns arguments of ROS whose meaning is not obvious."""
    names = ["a", "robot", "front", "urg_node"]
    part = lambda *more: chance.choice([*names, *more])
    path = lambda *more: "/".join(part(*more) for _ in range(chance.randint(1, 3)))
    arguments = []
    for _ in range(chance.randint(0, 3)):
        kind = chance.choice(["__node", "__ns", "scan", "/scan", f"/{part()}/scan", "other"])
        absolute = chance.choice(["", "/", "~/"])
        to = {"__node": part(), "__ns": f"/{path()}"}.get(kind, f"{absolute}{path()}")
        arguments += ["-r", f"{kind}:={to}"]
    for number in range(chance.randint(0, 3)):
        frame = chance.choice([f"f{number}", str(number), f"{number}.5", "true", "~a", "it's"])
        node = chance.choice(["/**", f"/{path('*', '**')}", f"/{path('*')}", "urg_node", "/*/urg_node"])
        if chance.random() < 0.5:
            prefix = chance.choice(["", "", f"{part()}:"])
            arguments += ["-p", f"{prefix}frame:={yaml.dump(frame)}"]
        else:
            arguments += ["--params-file", file_of({node: {"ros__parameters": {"frame": frame}}})]
    return ["--ros-args", *arguments]


def arguments_mean_what_they_mean_to_rclpy():
    seed = next((int(text) for text in sys.argv[3:] if text.isdigit()), random.randrange(10**6))
    chance = random.Random(seed)
    # `core` is what CI runs.
    count = 3 if "core" in sys.argv else 8
    for number in range(count):
        arguments = random_arguments(chance)
        expected = meant(arguments)
        found = seen(["publish", "emulated", *arguments])
        assert found == expected, f"seed {seed}, {number}: {arguments}: {found}, not {expected}"
    ok(f"{count} command lines mean what they mean to rclpy (seed {seed})")


def a_parameter_wins_over_an_option():
    arguments = ["--frame", "a", "--ros-args", "-p", "frame:=b", "--", "--frame-id", "c"]
    assert seen(["publish", "emulated", *arguments])[2] == "b"
    ok("a parameter wins over an option")


the_launch_file_of_the_guide()
a_parameter_wins_over_an_option()
arguments_mean_what_they_mean_to_rclpy()
shutil.rmtree(FOLDER)
os._exit(0)
