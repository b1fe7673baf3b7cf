// Viewers of `urg publish --engine foxglove`, as `foxglove.sh` starts them: what they get must
// be what the driver delivered.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { once } from "node:events";
import net from "node:net";
import { createInterface } from "node:readline";
import { setTimeout as sleep } from "node:timers/promises";
import protocol from "@foxglove/ws-protocol";
import rosmsg from "@foxglove/rosmsg";
import rosmsg2 from "@foxglove/rosmsg2-serialization";
import WebSocket from "ws";

const program = process.argv[2];
const children = new Set();
process.on("exit", () => children.forEach((child) => child.kill("SIGKILL")));

async function freePort() {
  const server = net.createServer().listen(0, "127.0.0.1");
  await once(server, "listening");
  const { port } = server.address();
  server.close();
  await once(server, "close");
  return port;
}

// A program, and a way to wait for a line of its standard error.
function run(program, ...args) {
  const child = spawn(program, args, { stdio: ["ignore", "ignore", "pipe"] });
  children.add(child);
  const lines = [];
  child.once("exit", (code) => {
    children.delete(child);
    if (code) console.error(`${args.join(" ")}: exit status ${code}\n${lines.join("\n")}`);
  });
  const waiting = new Set();
  createInterface({ input: child.stderr }).on("line", (line) => {
    lines.push(line);
    waiting.forEach((look) => look());
  });
  child.says = (text) =>
    new Promise((resolve) => {
      const look = () => {
        if (!lines.some((line) => line.includes(text))) return;
        waiting.delete(look);
        resolve();
      };
      waiting.add(look);
      look();
    });
  child.stop = async () => {
    child.kill("SIGINT");
    const [code] = await once(child, "exit");
    assert.equal(code, 0, lines.join("\n"));
  };
  return child;
}

const foxglove = (port) => ["--engine", "foxglove", "--listen", `127.0.0.1:${port}`];
const publish = (port, ...args) => run(program, "publish", ...args, ...foxglove(port));

// Reads all topics. `next(topic)` resolves with the next message of a topic.
async function viewer(port) {
  const socket = new WebSocket(`ws://127.0.0.1:${port}`, ["foxglove.sdk.v1"]);
  const client = new protocol.FoxgloveClient({ ws: socket });
  const channels = new Map();
  const messages = {};
  const waiting = {};
  client.on("advertise", (advertised) => {
    for (const channel of advertised) {
      assert.equal(channel.encoding, "cdr");
      assert.equal(channel.schemaEncoding, "ros2msg");
      const definitions = rosmsg.parse(channel.schema, { ros2: true });
      channels.set(client.subscribe(channel.id), {
        channel,
        reader: new rosmsg2.MessageReader(definitions),
      });
    }
  });
  client.on("message", ({ subscriptionId, data }) => {
    const { channel, reader } = channels.get(subscriptionId);
    const message = { ...reader.readMessage(data), schema: channel.schemaName };
    const resolve = waiting[channel.topic]?.shift();
    if (resolve) resolve(message);
    else (messages[channel.topic] ??= []).push(message);
  });
  await new Promise((resolve, reject) => {
    client.on("open", resolve);
    socket.on("error", reject);
  });
  return {
    close: () => client.close(),
    next: (topic) =>
      messages[topic]?.length
        ? messages[topic].shift()
        : new Promise((resolve) => (waiting[topic] ??= []).push(resolve)),
  };
}

const seconds = ({ sec, nsec, nanosec }) => sec + (nsec ?? nanosec) / 1e9;

async function viewersGetWhatTheDriverDelivered() {
  const recording = "run.mcap";
  execFileSync(program, ["record", "emulated", recording, "--count", "50"]);
  const truth = new Map();
  const output = execFileSync(program, ["stream", recording], { maxBuffer: 1e8 });
  for (const line of output.toString().trim().split("\n")) {
    const scan = JSON.parse(line);
    truth.set(scan.values.join(), scan);
  }
  const port = await freePort();
  const published = publish(port, `front=${recording}`, "--tf", "base_link,0.2,0,0.1,90,upside-down");
  await published.says("can connect to ws://");
  const reader = await viewer(port);
  for (let count = 0; count < 30; count++) {
    const scan = await reader.next("/front/scan");
    assert.equal(scan.schema, "sensor_msgs/msg/LaserScan");
    assert.equal(scan.header.frame_id, "front_laser");
    assert.equal(scan.ranges.length, 682);
    const values = Array.from(scan.ranges, (range, at) => [range, at]);
    const found = [...truth.values()].filter((scan) =>
      values.every(([range, at]) =>
        scan.values[at] < 20 ? !Number.isFinite(range) : Math.round(range * 1000) === scan.values[at],
      ),
    );
    assert.equal(found.length, 1, "a scan that the recording does not have");
    assert.ok(Math.abs(seconds(scan.header.stamp) - found[0].first_ray) < 1e-5);
  }
  const { transforms } = await reader.next("/tf_static");
  assert.equal(transforms[0].header.frame_id, "base_link");
  assert.equal(transforms[0].child_frame_id, "front_laser");
  assert.equal(transforms[0].transform.translation.x, 0.2);
  const { x, y, z, w } = transforms[0].transform.rotation;
  // Half a turn about the axis between x and y.
  const turns = [x, y, z, w].map((part, n) => Math.abs(part - (n < 2 ? Math.SQRT1_2 : 0)));
  assert.ok(Math.max(...turns) < 1e-12, `${[x, y, z, w]}`);
  const { status } = await reader.next("/diagnostics");
  assert.match(status[0].name, /front\/urg_node/);
  reader.close();
  published.kill("SIGKILL");
}

async function viewersComeAndGoAndThePublisherStops() {
  const port = await freePort();
  const published = publish(port, "emulated", "--tf", "map,0,0,0,0");
  await published.says("can connect to ws://");
  const first = await viewer(port);
  await first.next("/scan");
  const late = await viewer(port);
  await late.next("/tf_static");
  first.close();
  await late.next("/scan");

  published.kill("SIGSTOP");
  await sleep(1000);
  published.kill("SIGCONT");
  let stamp = 0;
  for (let count = 0; count < 20; count++) {
    const scan = await late.next("/scan");
    assert.ok(seconds(scan.header.stamp) > stamp, "a scan twice, or out of order");
    stamp = seconds(scan.header.stamp);
  }
  assert.ok(Math.abs(Date.now() / 1000 - stamp) < 5, "only old scans");

  // Another one waits until the address is free.
  const second = publish(port, "emulated");
  await second.says(`cannot serve Foxglove on 127.0.0.1:${port}`);
  await published.stop();
  await second.says("can connect to ws://");
  const reader = await viewer(port);
  await reader.next("/scan");
  await second.stop();
}

// The SDK's server stops listening when the system has no more files for it.
async function connectionsThatUseUpAllFilesDoNotEndTheServer() {
  const port = await freePort();
  const limited = ["-c", 'ulimit -n 40; exec "$0" "$@"', program, "publish", "emulated"];
  const published = run("bash", ...limited, ...foxglove(port));
  await published.says("can connect to ws://");
  const sockets = [];
  for (let count = 0; count < 60; count++) {
    sockets.push(net.connect(port, "127.0.0.1").on("error", () => {}));
  }
  await published.says("the engine is opened again");
  sockets.forEach((socket) => socket.destroy());
  for (let tries = 0; ; tries++) {
    try {
      const reader = await viewer(port);
      await reader.next("/scan");
      break;
    } catch (error) {
      assert.ok(tries < 20, error);
      await sleep(500);
    }
  }
  await published.stop();
}

// A viewer that speaks only the protocol before `foxglove.sdk.v1`, as Lichtblick 1.21 does.
async function viewersOfTheOlderProtocolAreRefused() {
  const port = await freePort();
  const published = publish(port, "emulated");
  await published.says("can connect to ws://");
  const older = new WebSocket(`ws://127.0.0.1:${port}`, "foxglove.websocket.v1");
  const [, response] = await once(older, "unexpected-response");
  assert.equal(response.statusCode, 400);
  const [body] = await once(response, "data");
  assert.match(body.toString(), /sec-websocket-protocol/);
  await published.stop();
}

for (const test of [
  viewersOfTheOlderProtocolAreRefused,
  viewersGetWhatTheDriverDelivered,
  viewersComeAndGoAndThePublisherStops,
  connectionsThatUseUpAllFilesDoNotEndTheServer,
]) {
  await test();
  console.log(`ok: ${test.name}`);
}
process.exit(0);
