#!/usr/bin/env bash
# roslibpy 2.1.0 (PyPI) and roslib 2.1.0 (npm) keep all that is published while rosbridge is away, and send it later.
#
# Here a program publishes a speed, such as one that a scan permits, 50 times a second, through an outage of 6 s, with
# `queue_size` 1. Expected once the connection is back: the newest speed, or none, since `is_connected` is false
# meanwhile. Both libraries send each of the 300, the oldest first, within a fraction of a second: a robot may be told
# to drive after it was told to stop. roslibpy sends the first ones even before it advertises their topic again.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import asyncio
import contextlib
import json
import os
import sys
import time

from place import compare, free_port, npm, pypi

IN_PYTHON = """
import sys
import time

import roslibpy

ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]), transport=sys.argv[2])
ros.run()
topic = roslibpy.Topic(ros, "/speed", "std_msgs/Float32", queue_size=1)
topic.publish({"data": time.time()})
sys.stdin.readline()
while ros.is_connected:
    time.sleep(0.1)
for number in range(300):
    topic.publish({"data": time.time()})
    time.sleep(0.02)
print("published", flush=True)
sys.stdin.readline()
"""
IN_JAVASCRIPT = """
import { once } from "node:events";
import { setTimeout as sleep } from "node:timers/promises";
import { Ros, Topic } from "roslib";

const url = `ws://127.0.0.1:${process.argv[2]}`;
const ros = new Ros({ url });
ros.on("error", () => {});
await new Promise((connected) => ros.once("connection", connected));
ros.on("close", () => setTimeout(() => ros.connect(url), 1000));
const topic = new Topic({ ros, name: "/speed", messageType: "std_msgs/Float32", queue_size: 1 });
topic.publish({ data: Date.now() / 1000 });
await once(process.stdin, "data");
while (ros.isConnected) await sleep(100);
for (let number = 0; number < 300; number++) {
    topic.publish({ data: Date.now() / 1000 });
    await sleep(20);
}
console.log("published");
"""
folder = npm("roslib@2.1.0")
(folder / "program.mjs").write_text(IN_JAVASCRIPT)
(folder / "program.py").write_text(IN_PYTHON)
os.environ["PYTHONPATH"] = str(pypi("roslibpy==2.1.0", "websockets==17.4"))
import websockets  # noqa: E402


async def outage(program, file, *transport):
    """Returns what rosbridge gets from a program after an outage in which the program publishes."""
    port, received = free_port(), asyncio.Queue()

    async def serve(connection):
        """Does what rosbridge does with a publisher."""
        with contextlib.suppress(websockets.ConnectionClosed):
            async for message in connection:
                received.put_nowait((time.time(), json.loads(message)))

    async def receive(seconds):
        return await asyncio.wait_for(received.get(), seconds)

    pipes = {"stdin": asyncio.subprocess.PIPE, "stdout": asyncio.subprocess.PIPE}
    async with websockets.serve(serve, "127.0.0.1", port):
        program = await asyncio.create_subprocess_exec(program, file, str(port), *transport, cwd=folder, **pipes)
        while (await receive(60))[1]["op"] != "publish":
            pass
    program.stdin.write(b"\n")
    await program.stdout.readline()
    messages = []
    async with websockets.serve(serve, "127.0.0.1", port):
        with contextlib.suppress(asyncio.TimeoutError):
            while True:
                messages.append(await receive(30 if not messages else 3))
    program.kill()
    await program.wait()
    speeds = [(at, message["msg"]["data"]) for at, message in messages if message["op"] == "publish"]
    duration, age = speeds[-1][0] - speeds[0][0], speeds[0][0] - speeds[0][1]
    print(f"{len(speeds)} speeds in {duration:.2f} s, the oldest {age:.1f} s old")
    return {
        "first": messages[0][1]["op"],
        "speeds": len(speeds),
        "in order": speeds == sorted(speeds, key=lambda speed: speed[1]),
        "within a second": duration < 1,
        "the first is 5 s old": age > 5,
    }


seen = {
    "roslibpy": asyncio.run(outage(sys.executable, "program.py", "twisted")),
    "roslibpy, asyncio": asyncio.run(outage(sys.executable, "program.py", "asyncio")),
    "roslib": asyncio.run(outage("node", "program.mjs")),
}
SENT = {"speeds": 300, "in order": True, "within a second": True, "the first is 5 s old": True}
compare(seen, {
    "roslibpy": {"first": "publish", **SENT},
    "roslibpy, asyncio": {"first": "publish", **SENT},
    "roslib": {"first": "advertise", **SENT},
})
END
