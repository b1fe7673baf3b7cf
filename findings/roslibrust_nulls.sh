#!/usr/bin/env bash
# roslibrust 0.26.0 (crates.io): over rosbridge, a subscriber gets no scan with a point beyond the range, and no error.
#
# JSON has no infinity, so rosbridge sends `null`, and LaserScans are full of it (REP 117). Expected of a library for
# ROS: infinity or NaN, or an error from `next`. But it skips such a scan, and waits for the following one. Only a
# logger is told, if the program has one. What it publishes has `null`, too, and `publish` succeeds; rosbridge-server-rs
# 0.1.6 (PyPI) then refuses the message: "field sensor_msgs/msg/LaserScan.ranges: expected number".
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import asyncio
import json

from place import cargo, compare, free_port, pypi

PROGRAM = """
use std::time::Duration;

use roslibrust::rosbridge::ClientHandle;
use roslibrust::{MessageDescriptor, RosMessageType};

// Has only the field that is looked at.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
struct Scan {
    ranges: Vec<f32>,
}

impl RosMessageType for Scan {
    const DESCRIPTION: MessageDescriptor =
        MessageDescriptor::new::<Self>("sensor_msgs/LaserScan", "", "", "", &[0; 32]);
}

#[tokio::main]
async fn main() {
    let client = ClientHandle::new(std::env::args().nth(1).unwrap()).await.unwrap();
    let publisher = client.advertise::<Scan>("/copy").await.unwrap();
    let sent = publisher.publish(&Scan { ranges: vec![1.5, f32::INFINITY] }).await;
    let scans = client.subscribe::<Scan>("/scan").await.unwrap();
    let mut received = Vec::new();
    while let Ok(scan) = tokio::time::timeout(Duration::from_secs(3), scans.next()).await {
        received.push(scan.ranges);
    }
    println!("{:?} {received:?}", sent.is_ok());
}
"""
pypi("websockets==17.4")
import websockets  # noqa: E402

published = []


async def serve(connection):
    """Does what rosbridge does with a publisher and a subscriber, until the client closes the connection."""
    while True:
        try:
            message = json.loads(await connection.recv())
        except websockets.ConnectionClosed:
            return
        if message["op"] == "publish":
            published.append(message["msg"]["ranges"])
        if message["op"] == "subscribe":
            for ranges in [[1.5, 2.5], [1.5, None], [None, None], [3.5, 4.5]]:
                scan = {"op": "publish", "topic": "/scan", "msg": {"ranges": ranges}}
                await connection.send(json.dumps(scan))


async def run(program):
    port = free_port()
    async with websockets.serve(serve, "127.0.0.1", port):
        arguments = [program, f"ws://127.0.0.1:{port}"]
        process = await asyncio.create_subprocess_exec(*arguments, stdout=asyncio.subprocess.PIPE)
        output, _ = await process.communicate()
        return output.decode().strip()


program = cargo(PROGRAM, 'roslibrust = { version = "=0.26.0", features = ["rosbridge"] }',
                'serde = { version = "1", features = ["derive"] }',
                'tokio = { version = "1", features = ["macros", "rt-multi-thread", "time"] }')
is_sent, received = asyncio.run(run(program)).split(maxsplit=1)
compare({"publish succeeds": is_sent, "as JSON": published, "received of four": received}, {
    "publish succeeds": "true",
    "as JSON": [[1.5, None]],
    "received of four": "[[1.5, 2.5], [3.5, 4.5]]",
})
END
