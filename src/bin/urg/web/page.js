// The page around the radar: where scans come from, how it goes, and what
// keys, mouse and fingers do. Text from the sensor is set as text only.

const by = (id) => document.getElementById(id);
const radar = new Radar(by("radar"));

function say(id, text) {
  const element = by(id);
  if (element.textContent !== text) element.textContent = text;
}

// ---- how it goes -------------------------------------------------------

let report = null; // the latest /state, or null while the server is away
let scanned = 0; // when the latest scan came, or was first asked for, on this page's clock
let refused = false; // whether the server has no place for another viewer
let paused = false;
let newest = null; // the latest scan, also while the picture is paused

// Whether scans should have come in here by now.
const overdue = () => performance.now() - scanned > 3000 / (report?.asked ?? 1) + 3000;

const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);

// One word for the pill, and what to say on the radar, if anything.
function condition() {
  if (!report) return ["bad", "Server away", "The server does not answer. Trying again…"];
  if (report.link === "waiting") return ["wait", "No sensor yet", `${sentence(report.why)}…`];
  if (report.link === "recovering") return ["bad", "Sensor silent", "The sensor is silent. Looking for it…"];
  if (report.why && report.link !== "connected") return ["bad", "Sensor away", `${sentence(report.why)}. Waiting for it…`];
  if (report.why) return ["bad", "No scans", sentence(report.why)];
  if (refused) return ["wait", "No place", "Too many viewers are watching. Trying again…"];
  if (overdue()) return ["wait", "No scans", "No scans come in here. Trying again…"];
  return paused ? ["wait", "Paused", ""] : ["good", "Live", ""];
}

function show() {
  const [level, word, text] = condition();
  say("status", word);
  by("status").dataset.level = level;
  say("banner", text);
  by("banner").hidden = !text;
  const stale = Boolean(text);
  if (radar.stale !== stale) { radar.stale = stale; radar.ask(); }
}

// A number with what it is measured against, small.
function figure(id, number, rest) {
  const small = document.createElement("small");
  small.textContent = ` ${rest}`;
  by(id).replaceChildren(number, small);
}

function rows(list) {
  by("details").replaceChildren(...list.filter(([, value]) => value !== null && value !== undefined).flatMap(([name, value]) => {
    const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
    dt.textContent = name; dd.textContent = value;
    return [dt, dd];
  }));
}

function tell() {
  const { stats, sensor, latency } = report;
  if (sensor) {
    say("product", sensor.product);
    document.title = `${sensor.product} – urg`;
  }
  say("identity", [sensor?.serial_number, report.port, report.baud_rate ? `${report.baud_rate} baud` : null].filter(Boolean).join(" · "));
  figure("rate", report.reached && !report.why ? report.reached.toFixed(1) : "–", report.asked ? `of ${Number(report.asked.toFixed(2))} Hz` : "Hz, as fast as it goes");
  if (latency) figure("latency", (latency.last * 1000).toFixed(0), "ms");
  const damaged = Object.values(stats.malformed).reduce((sum, count) => sum + count, 0);
  const lost = damaged + stats.timeouts + stats.refused;
  figure("lost", String(lost), lost === 1 ? "reply" : "replies");
  rows([
    ["Link", report.link],
    ["Line", report.baud_rate ? `${report.baud_rate} baud` : report.link === "connected" ? "no baud rate (USB)" : null],
    ["Window", `steps ${report.window.start} to ${report.window.end}` + (report.window.cluster > 1 ? `, by ${report.window.cluster}` : "")],
    ["Scans", stats.scans],
    ["Not answered", stats.timeouts],
    ["Damaged", damaged],
    ["Refused", stats.refused],
    ["Polls skipped", stats.polls_skipped],
    ["Link lost", `${stats.disconnects}×`],
    ["Latency, mean", latency ? `${(latency.mean * 1000).toFixed(0)} ms` : null],
    ["Latency, longest", latency ? `${(latency.max * 1000).toFixed(0)} ms` : null],
    ["Viewers", report.viewers],
    ["Vendor", sensor?.vendor], ["Firmware", sensor?.firmware], ["Protocol", sensor?.protocol], ["Status", sensor?.status],
    ["urg", report.urg],
  ]);
}

async function ask() {
  try {
    const response = await fetch("/state", { signal: AbortSignal.timeout(3000) });
    report = await response.json();
    tell();
  } catch {
    report = null;
  }
  show();
}

// ---- scans -------------------------------------------------------------

let source = null;

function listen() {
  source?.close();
  source = new EventSource("/scans");
  scanned = performance.now();
  source.onopen = () => { refused = false; ask(); };
  source.onmessage = (message) => {
    const data = JSON.parse(message.data);
    if (data.event) { ask(); return; }
    scanned = performance.now();
    newest = data;
    if (!paused) take(data);
  };
  source.onerror = () => {
    // Closed by itself: the server refused. Else the server is away.
    refused = source.readyState === EventSource.CLOSED;
    source.close();
    source = null;
    ask();
  };
}

function take(scan) {
  radar.scan = scan;
  radar.ask();
  const counts = { far: 0, weak: 0, none: 0 };
  let [near, at] = [Infinity, 0];
  scan.values.forEach((value, index) => {
    const { kind, distance } = meaning(value);
    if (kind !== "distance") counts[kind]++;
    else if (distance < near) [near, at] = [distance, index];
  });
  for (const kind in counts) say(kind, String(counts[kind]));
  if (near < Infinity) figure("nearest", near.toFixed(2), `m at ${direction(radar.angle(at), 0)}`);
  else say("nearest", "–");
  describe();
  show();
}

const direction = (radians, digits = 1) => `${degrees(radians).toFixed(digits)}°`.replace("-", "−");

// The point that is pointed at, if one is.
function describe() {
  const index = radar.indexOf(radar.chosen);
  if (index === null) return say("point", "");
  const { start, cluster, values } = radar.scan;
  say("point", `${direction(radar.angle(index))} · ${meaning(values[index]).text} · step ${start + index * cluster}`);
}

// A hidden page takes no scans, and one that lost its stream gets another.
function tend() {
  if (document.hidden) { source?.close(); source = null; return; }
  // A network that went away does not always say so.
  if (!source || (report && !report.why && overdue())) listen();
  ask();
}
document.addEventListener("visibilitychange", tend);
setInterval(tend, 1000);
tend();

// ---- hands -------------------------------------------------------------

const canvas = by("radar");
const fingers = new Map();

function choose(angle) {
  radar.chosen = angle;
  describe();
  radar.ask();
}

function pause() {
  paused = !paused;
  by("pause").setAttribute("aria-pressed", String(paused));
  if (!paused && newest) take(newest);
  show();
}

function spot(event) {
  const box = canvas.getBoundingClientRect();
  return { x: event.clientX - box.left, y: event.clientY - box.top };
}

canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  const { x, y } = spot(event);
  const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
  radar.zoom(Math.exp(-Math.max(-200, Math.min(200, event.deltaY * lines)) / 400), x, y);
}, { passive: false });

canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, spot(event));
});
canvas.addEventListener("pointermove", (event) => {
  const now = spot(event);
  const before = fingers.get(event.pointerId);
  if (!before) return choose(radar.pick(now.x, now.y));
  const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
  if (other) {
    const apart = (at) => Math.max(Math.hypot(at.x - other.x, at.y - other.y), 10);
    radar.zoom(apart(now) / apart(before), (now.x + other.x) / 2, (now.y + other.y) / 2);
    radar.pan((now.x - before.x) / 2, (now.y - before.y) / 2);
  } else {
    radar.pan(now.x - before.x, now.y - before.y);
  }
  fingers.set(event.pointerId, now);
});
for (const name of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
}
canvas.addEventListener("click", (event) => {
  const { x, y } = spot(event);
  choose(radar.pick(x, y));
});
canvas.addEventListener("dblclick", () => radar.fit());
canvas.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") choose(null); });

function step(count) {
  if (!radar.scan) return;
  const last = radar.scan.values.length - 1;
  const index = radar.indexOf(radar.chosen) ?? Math.round(last / 2) - count;
  choose(radar.angle(Math.min(Math.max(index + count, 0), last)));
  say("spoken", by("point").textContent);
}

canvas.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const far = event.shiftKey ? 10 : 1;
  const keys = {
    "+": () => radar.zoom(1.4), "=": () => radar.zoom(1.4), "-": () => radar.zoom(1 / 1.4), "0": () => radar.fit(),
    ArrowLeft: () => step(far), ArrowRight: () => step(-far), Escape: () => choose(null), " ": pause,
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});
by("in").onclick = () => radar.zoom(1.4);
by("out").onclick = () => radar.zoom(1 / 1.4);
by("fit").onclick = () => radar.fit();
by("pause").onclick = pause;

// The legend of distances.
function legend() {
  const context = by("scale").getContext("2d");
  const width = context.canvas.width;
  for (let x = 0; x < width; x++) {
    context.fillStyle = radar.colour(x / width * REACH);
    context.fillRect(x, 0, 1, 10);
  }
}
legend();
matchMedia("(prefers-color-scheme: light)").addEventListener("change", legend);
