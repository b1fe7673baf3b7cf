// Page around the radar: fetches scans and the state of the server, shows the state,
// and handles keys, mouse and touch.

const radar = new Radar(by("radar"));
const deck = new Deck();

// ---- state -------------------------------------------------------------

let sensors = []; // in the server's order
let answered = null; // time of the server's last answer, on this page's clock
let away = false; // whether the server is not answering
let paused = false;

// Pill of the whole page, and text of the banner.
function condition() {
  if (away) {
    const since = answered ? ` since ${time(answered)}` : "";
    return ["bad", "Server away", `The server does not answer${since}. Trying again…`];
  }
  if (!sensors.length) return ["wait", "Connecting", ""];
  const states = sensors.map((sensor) => [sensor, ...sensor.condition()]);
  const bad = states.filter(([, , , text]) => text);
  const text = bad.map(([sensor, , , text]) => sensor.name === null ? text : `${sensor.name}: ${text}`).join("\n");
  if (bad.length) {
    const [, level, word] = bad[0];
    return [level, sensors.length > 1 ? `${bad.length} of ${sensors.length} away` : word, text];
  }
  if (paused) return ["wait", "Paused", ""];
  const [, level, word] = states[0];
  return [level, word, ""];
}

function show() {
  const [level, word, text] = condition();
  setText(by("status"), word);
  by("status").dataset.level = level;
  setText(by("banner"), text);
  by("banner").hidden = !text;
  for (const sensor of sensors) {
    const [level, word, trouble] = sensor.condition();
    const state = sensor.of("state");
    setText(state, away ? "" : word);
    state.dataset.level = level;
    sensor.setStale(away || Boolean(trouble));
  }
  legend();
  radar.requestDraw();
}

function applyReport(report) {
  const names = (list) => JSON.stringify(list.map(({ name }) => name));
  if (names(sensors) !== names(report.sensors)) {
    const several = report.sensors.length > 1;
    sensors = report.sensors.map((report, number) => new Sensor(report, number, several));
    by("cards").replaceChildren(...sensors.map((sensor) => sensor.card));
    document.body.classList.toggle("several", several);
    radar.layers = sensors;
  }
  sensors.forEach((sensor, number) => {
    sensor.report = report.sensors[number];
    sensor.window = sensor.report.window;
    sensor.showReport();
  });
  const [first] = report.sensors;
  if (sensors.length > 1) {
    setText(by("product"), sensors.map(({ name }) => name).join(", "));
    document.title = `${sensors.length} sensors – urg`;
  } else if (first.sensor) {
    setText(by("product"), first.sensor.product);
    document.title = `${first.sensor.product} – urg`;
  }
  const viewers = `${report.viewers} ${report.viewers === 1 ? "viewer" : "viewers"}`;
  const one = [first.sensor?.serial_number, first.port, first.baud_rate ? `${first.baud_rate} baud` : null];
  const models = report.sensors.map(({ name, sensor }) => sensor && `${name}: ${sensor.product}`);
  setText(by("identity"), (sensors.length > 1 ? models : one).filter(Boolean).join(" · "));
  setText(by("about"), `${viewers} · urg ${report.urg}`);
  deck.update(report.sensors.find(({ playback }) => playback)?.playback ?? null);
}

async function fetchState() {
  try {
    const response = await fetch("/state", { signal: AbortSignal.timeout(3000) });
    applyReport(await response.json());
    answered = Date.now();
    away = false;
  } catch {
    away = true;
  }
  show();
}

// ---- scans -------------------------------------------------------------

let source = null;

function listen() {
  source?.close();
  source = new EventSource("/scans?old");
  for (const sensor of sensors) { sensor.started = performance.now(); sensor.came &&= { ...sensor.came, at: sensor.started }; }
  source.onopen = fetchState;
  source.onmessage = (message) => {
    const data = JSON.parse(message.data);
    const sensor = sensors.find(({ name }) => name === (data.sensor ?? null));
    if (!sensor) return;
    if (data.playback) { sensor.report.playback = data.playback; deck.update(data.playback); show(); return; }
    if (data.event) { fetchState(); return; }
    // Its values mean nothing yet.
    if (!sensor.report.geometry) { fetchState(); return; }
    sensor.receive(data);
    if (data.position !== undefined) deck.moveTo(data.sequence, data.position);
    if (paused) return;
    sensor.advance();
    describe();
    show();
  };
  source.onerror = () => {
    source.close();
    source = null;
    fetchState();
  };
}

// Describes the selected point.
function describe() {
  const { layer, angle } = radar.chosen ?? {};
  const index = indexOf(layer?.scan, angle ?? null);
  if (index === null) return setText(by("point"), "");
  const { start, cluster, values, intensities } = layer.scan;
  const name = layer.name === null ? "" : `${layer.name} · `;
  setText(by("point"), `${name}${direction(angleOf(layer.scan, index))} · ${meaning(layer, values[index]).text} · step ${start + index * cluster}${intensities ? ` · intensity ${intensities[index]}` : ""}`);
}

// Closes the stream of a hidden page, and replaces a lost stream.
function keepAlive() {
  if (document.hidden) { source?.close(); source = null; return; }
  // A lost network does not always cause an error.
  const silent = sensors.length && sensors.every((sensor) => !sensor.report.why && sensor.overdue());
  if (!source || silent) listen();
  fetchState();
}
document.addEventListener("visibilitychange", keepAlive);
setInterval(keepAlive, 1000);
fetchState().then(keepAlive);

// ---- input -------------------------------------------------------------

const canvas = by("radar");
const fingers = new Map();

function choose(point) {
  radar.chosen = point;
  describe();
  radar.requestDraw();
}

function pause() {
  paused = !paused;
  by("pause").setAttribute("aria-pressed", String(paused));
  if (!paused) sensors.forEach((sensor) => sensor.advance());
  show();
}

function trail() {
  radar.trail = !radar.trail;
  by("trail").setAttribute("aria-pressed", String(radar.trail));
  radar.requestDraw();
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
  const layer = radar.chosen?.layer ?? sensors[0];
  if (!layer?.scan) return;
  const last = layer.scan.values.length - 1;
  const index = indexOf(layer.scan, radar.chosen?.angle ?? null) ?? Math.round(last / 2) - count;
  choose({ layer, angle: angleOf(layer.scan, Math.min(Math.max(index + count, 0), last)) });
  setText(by("spoken"), by("point").textContent);
}

// Keys work wherever the focus is, except in elements that use them.
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.closest?.("input, select")) return;
  if (event.target.closest?.("button, summary") && (event.key === " " || event.key === "Enter")) return;
  const far = event.shiftKey ? 10 : 1;
  const keys = {
    "+": () => radar.zoom(1.4), "=": () => radar.zoom(1.4), "-": () => radar.zoom(1 / 1.4), "0": () => radar.fit(),
    ArrowLeft: () => step(far), ArrowRight: () => step(-far), Escape: () => choose(null), " ": pause, t: trail,
  };
  const action = deck.key(event.key, event.target === canvas) ?? keys[event.key];
  if (!action) return;
  event.preventDefault();
  action();
});
by("in").onclick = () => radar.zoom(1.4);
by("out").onclick = () => radar.zoom(1 / 1.4);
by("fit").onclick = () => radar.fit();
by("trail").onclick = trail;
by("pause").onclick = pause;

// Legend of the distances or intensities of a single sensor, drawn anew when their colours change.
let drawn = null;
function legend() {
  const { band } = radar;
  const shaded = Boolean(sensors[0]?.scan?.intensities);
  const palette = shaded ? radar.shades.null : radar.palette;
  const is = JSON.stringify([band, palette]);
  if (is === drawn) return;
  drawn = is;
  setText(by("colours"), shaded ? "Intensity" : "Distance");
  const mark = (n) => shaded ? 2 ** (WEAKEST + n) : n * band;
  [...by("marks").children].forEach((element, n) =>
    setText(element, `${mark(n * BANDS / 4)}${n === 4 && !shaded ? " m" : ""}`));
  setText(by("bands"), shaded
    ? `Points have a shade for each doubling of the intensity, from violet, ${mark(0)}, to orange, ${mark(BANDS)}.`
    : `Points have a colour for each ${band} m, from orange, near, to violet, ${BANDS * band} metres away.`);
  const context = by("scale").getContext("2d");
  const width = context.canvas.width / BANDS;
  for (let n = 0; n < BANDS; n++) {
    context.fillStyle = palette[n];
    context.fillRect(n * width, 0, width, 10);
  }
}
legend();
matchMedia("(prefers-color-scheme: light)").addEventListener("change", legend);
