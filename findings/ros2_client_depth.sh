#!/usr/bin/env bash
# ros2-client 0.12.1 (crates.io), ROS 2 over RustDDS 0.15.1, ignores the depth of a subscription's history.
#
# Its default for subscriptions is "keep-last depth 1". Expected of a program that needs 0.5 s for each of ten messages a
# second: the newest one each time, as with Cyclone DDS 11.0.1 (PyPI). But it gets them in turn, until each is 6 to 8 s
# old: the reader keeps the last 64 or more, whatever the depth. Of those taken until none is left, the last one is new.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import os
import subprocess
import sys
import time

from cyclone_writer import cyclone_writer
from place import cargo, compare, network, pypi, run

PROGRAM = """
use std::thread::sleep;
use std::time::{Duration, SystemTime};

use ros2_client::{Context, DEFAULT_SUBSCRIPTION_QOS, MessageTypeName, Name, NodeName, NodeOptions};

fn main() {
    let takes_all = std::env::args().nth(1).unwrap() == "all";
    let context = Context::new().unwrap();
    let name = NodeName::new("/", "reader").unwrap();
    let mut node = context.new_node(name, NodeOptions::new()).unwrap();
    let (name, text) = (Name::new("/", "text").unwrap(), MessageTypeName::new("std_msgs", "String"));
    let topic = node.create_topic(&name, text, &DEFAULT_SUBSCRIPTION_QOS).unwrap();
    let subscription = node.create_subscription::<String>(&topic, None).unwrap();
    loop {
        let mut newest = None;
        while let Ok(Some((text, _))) = subscription.take() {
            newest = Some(text);
            if !takes_all {
                break;
            }
        }
        if let Some(sent) = newest {
            let now = SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
            println!("{}", now - sent.trim().parse::<f64>().unwrap());
            sleep(Duration::from_millis(490));
        }
        sleep(Duration::from_millis(10));
    }
}
"""
CYCLONE = cyclone_writer(0, "rt/text", "std_msgs::msg::dds_::String_") + "import time\n"
WRITER = CYCLONE + """
while True:
    # As long as a scan of a URG-04LX.
    writer.write(Text(str(time.time()).ljust(2_788)))
    time.sleep(0.1)
"""
READER = CYCLONE + """
from cyclonedds.sub import DataReader
reader = DataReader(participant, Topic(participant, "rt/text", Text), qos=qos)
while True:
    for text in reader.take(1):
        print(time.time() - float(text.data), flush=True)
        time.sleep(0.49)
    time.sleep(0.01)
"""
os.environ["PYTHONPATH"] = str(pypi("cyclonedds==11.0.1"))
program = cargo(PROGRAM, 'ros2-client = "=0.12.1"', 'rustdds = "=0.15.1"')
network()
run(sys.executable, "-c", WRITER)
readers = {
    "Cyclone DDS": [sys.executable, "-c", READER],
    "ros2-client": [program, "one"],
    "ros2-client, taken until none is left": [program, "all"],
}
processes = {name: run(*command, stdout=subprocess.PIPE, text=True) for name, command in readers.items()}
time.sleep(30)
seen = {}
for name, process in processes.items():
    process.kill()
    # The last line may be cut off.
    ages = [float(line) for line in process.stdout.read().splitlines()[:-1]]
    print(f"{name}: seconds, each fifth message:", [round(age, 1) for age in ages[::5]])
    seen[name] = {"first below 1 s": ages[0] < 1, "last ten": "below 1 s" if max(ages[-10:]) < 1 else
                  "6 to 8 s" if 6 < min(ages[-10:]) and max(ages[-10:]) < 8 else "other"}
compare(seen, {
    "Cyclone DDS": {"first below 1 s": True, "last ten": "below 1 s"},
    "ros2-client": {"first below 1 s": True, "last ten": "6 to 8 s"},
    "ros2-client, taken until none is left": {"first below 1 s": True, "last ten": "below 1 s"},
})
END
