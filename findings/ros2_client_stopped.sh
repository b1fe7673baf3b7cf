#!/usr/bin/env bash
# ros2-client 0.12.1 (crates.io), ROS 2 over RustDDS 0.15.1, never receives again after a signal stopped its program.
#
# A signal stops the program for a second, as Ctrl-Z or a debugger does. Expected: messages again as soon as it
# continues, as with Cyclone DDS 11.0.1 (PyPI). But Linux then interrupts the wait for packets (EINTR), and both
# threads of RustDDS end for that. The program runs on: `take` finds no message, and no call returns an error.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import signal
import subprocess
import sys
import threading
import time

from cyclone_writer import cyclone_writer
from place import cargo, compare, network, pypi, run

PROGRAM = """
use std::thread::sleep;
use std::time::Duration;

use ros2_client::{Context, DEFAULT_SUBSCRIPTION_QOS, MessageTypeName, Name, NodeName, NodeOptions};

fn main() {
    let context = Context::new().unwrap();
    let name = NodeName::new("/", "reader").unwrap();
    let mut node = context.new_node(name, NodeOptions::new()).unwrap();
    let (name, text) = (Name::new("/", "text").unwrap(), MessageTypeName::new("std_msgs", "String"));
    let topic = node.create_topic(&name, text, &DEFAULT_SUBSCRIPTION_QOS).unwrap();
    let subscription = node.create_subscription::<String>(&topic, None).unwrap();
    loop {
        match subscription.take() {
            Ok(Some(_)) => println!("text"),
            Ok(None) => sleep(Duration::from_millis(10)),
            Err(error) => println!("error: {error:?}"),
        }
    }
}
"""
CYCLONE = cyclone_writer(0, "rt/text", "std_msgs::msg::dds_::String_") + "import time\n"
WRITER = CYCLONE + """
while True:
    write()
    time.sleep(0.1)
"""
READER = CYCLONE + """
from cyclonedds.sub import DataReader
reader = DataReader(participant, Topic(participant, "rt/text", Text), qos=qos)
while True:
    if reader.take(1): print("text", flush=True)
    time.sleep(0.01)
"""
os.environ["PYTHONPATH"] = str(pypi("cyclonedds==11.0.1"))
program = cargo(PROGRAM, 'ros2-client = "=0.12.1"', 'rustdds = "=0.15.1"')
network()
run(sys.executable, "-c", WRITER)


def collect(output, lines):
    for line in output:
        lines.append((time.monotonic(), line.strip()))


readers, received = {}, {}
for name, command in {"Cyclone DDS": [sys.executable, "-c", READER], "ros2-client": [program]}.items():
    readers[name] = run(*command, stdout=subprocess.PIPE, text=True)
    received[name] = []
    threading.Thread(target=collect, args=(readers[name].stdout, received[name]), daemon=True).start()
time.sleep(10)
for reader in readers.values():
    reader.send_signal(signal.SIGSTOP)
stopped = time.monotonic()
time.sleep(1)
for reader in readers.values():
    reader.send_signal(signal.SIGCONT)
time.sleep(60)
seen = {}
for name, reader in readers.items():
    # What was on its way when it stopped comes at once.
    after = [line for at, line in received[name] if at > stopped + 3]
    before = [line for at, line in received[name] if at < stopped]
    print(f"{name}: {len(before)} lines before, {len(after)} after")
    seen[name] = {"before": set(before), "after": set(after), "runs": reader.poll() is None}
compare(seen, {
    "Cyclone DDS": {"before": {"text"}, "after": {"text"}, "runs": True},
    "ros2-client": {"before": {"text"}, "after": set(), "runs": True},
})
END
