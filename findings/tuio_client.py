"""Reads frames of TUIO with tuio-client 0.1.0 (npm)."""

import json
import subprocess

from place import npm

# Node cannot import the package by its name alone: `main` is CommonJS in a package of modules.
READ = """
import { Tuio11Client, TuioReceiver } from "tuio-client/dist/tuio-client.es.js";
import fs from "fs";
class Receiver extends TuioReceiver {
  connect() {}
  disconnect() {}
}
const receiver = new Receiver();
const client = new Tuio11Client(receiver);
const events = [];
const note = (what) => (cursor) => events.push([what, cursor.sessionId, cursor.position.x]);
client.addTuioListener({
  addTuioCursor: note("add"),
  updateTuioCursor: note("update"),
  removeTuioCursor: note("remove"),
  refresh() {},
});
client.connect();
for (const frame of JSON.parse(fs.readFileSync(0)))
  for (const args of frame) receiver.onOscMessage({ address: "/tuio/2Dcur", args });
console.log(JSON.stringify(events));
"""

folder = npm("tuio-client@0.1.0")
(folder / "read.mjs").write_text(READ)


def events(frames):
    """Returns what a listener is told: add, update or remove, the session id, and x."""
    told = subprocess.check_output(["node", "read.mjs"], cwd=folder, input=json.dumps(frames).encode())
    return [(what, key, x) for what, key, x in json.loads(told)]
