#!/usr/bin/env bash
# roslibpy 2.1.0 (PyPI): one subscriber of a topic unsubscribes, and the others of its program get no message any more.
#
# Two parts of a program, such as a map and a display, have a `Topic` for /scan each, over one connection. Expected of
# `unsubscribe` of one: rosbridge, which gave each an id, continues for the other, and so does roslibpy, as roslib 2.1.0
# (npm) does. rosbridge does continue, but roslibpy removes the callbacks of all: the other gets nothing, although its
# `is_subscribed` stays true, and no error.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import asyncio
import contextlib
import json
import os
import sys

from place import compare, free_port, npm, pypi

IN_PYTHON = """
import sys
import time

import roslibpy

ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
ros.run()
map, display = [roslibpy.Topic(ros, "/scan", "sensor_msgs/LaserScan") for _ in range(2)]
received = []
map.subscribe(lambda _: None)
display.subscribe(received.append)
time.sleep(1)
before = len(received)
map.unsubscribe()
time.sleep(1)
received.clear()
time.sleep(2)
print(before > 0, len(received) > 0, display.is_subscribed)
"""
IN_JAVASCRIPT = """
import { setTimeout as sleep } from "node:timers/promises";
import { Ros, Topic } from "roslib";

const ros = new Ros({ url: `ws://127.0.0.1:${process.argv[2]}` });
await new Promise((connected) => ros.once("connection", connected));
const [map, display] = [0, 1].map(() => new Topic({ ros, name: "/scan", messageType: "sensor_msgs/LaserScan" }));
let received = 0;
map.subscribe(() => {});
display.subscribe(() => received++);
await sleep(1000);
const before = received;
map.unsubscribe();
await sleep(1000);
received = 0;
await sleep(2000);
console.log(before > 0, received > 0);
process.exit();
"""
folder = npm("roslib@2.1.0")
(folder / "program.mjs").write_text(IN_JAVASCRIPT)
(folder / "program.py").write_text(IN_PYTHON)
os.environ["PYTHONPATH"] = str(pypi("roslibpy==2.1.0", "websockets==17.4"))
import websockets  # noqa: E402

SCAN = json.dumps({"op": "publish", "topic": "/scan", "msg": {"ranges": [1.5, 2.5]}})


async def send(connection, subscribers):
    """Sends scans as long as there are subscribers."""
    with contextlib.suppress(websockets.ConnectionClosed):
        while subscribers:
            await connection.send(SCAN)
            await asyncio.sleep(0.1)


async def serve(connection):
    """Does what rosbridge does with subscribers of one topic."""
    subscribers = set()
    with contextlib.suppress(websockets.ConnectionClosed):
        async for message in connection:
            message = json.loads(message)
            if message["op"] == "subscribe":
                subscribers.add(message["id"])
                if len(subscribers) == 1:
                    sending = asyncio.create_task(send(connection, subscribers))
            if message["op"] == "unsubscribe":
                subscribers.remove(message["id"])
                print(f"subscribers left: {len(subscribers)}")
    subscribers.clear()
    await sending


async def run(program, file):
    port = free_port()
    async with websockets.serve(serve, "127.0.0.1", port):
        process = await asyncio.create_subprocess_exec(program, file, str(port), cwd=folder,
                                                       stdout=asyncio.subprocess.PIPE)
        output, _ = await process.communicate()
        return output.decode().split()


before, after, is_subscribed = asyncio.run(run(sys.executable, "program.py"))
seen = {"roslibpy, before": before, "roslibpy, after": after, "roslibpy, is_subscribed": is_subscribed}
seen["roslib, before"], seen["roslib, after"] = asyncio.run(run("node", "program.mjs"))
compare(seen, {
    "roslibpy, before": "True",
    "roslibpy, after": "False",
    "roslibpy, is_subscribed": "True",
    "roslib, before": "true",
    "roslib, after": "true",
})
END
