// The radar: how a scan is drawn, and where things are on it. Knows nothing of
// where scans come from. The front is up, and angles count to the left.

// How far the radar goes, in metres, and where directions without a distance
// are marked.
const REACH = 4;
const MARKS = { none: 4.16, weak: 4.26, far: 4.36 };
const LABELS = 4.62;
const COLOURS = 64;

const degrees = (radians) => radians * 180 / Math.PI;

// What a raw value means: "distance" in metres, or why there is none.
function meaning(value) {
  if (value >= 4095) return { kind: "far", text: "no distance: saturated" };
  if (value >= 20) return { kind: "distance", distance: value / 1000, text: `${(value / 1000).toFixed(3)} m` };
  const code = CODES[value];
  return { kind: code.kind, text: `no distance, code ${value}: ${code.meaning}` };
}

class Radar {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.scan = null;
    this.chosen = null; // an angle, in radians
    this.stale = false;
    this.view = null; // null: fitted
    this.themed();
    new ResizeObserver(() => this.resized()).observe(canvas);
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { this.themed(); this.ask(); });
  }

  themed() {
    const style = getComputedStyle(document.documentElement);
    const value = (name) => style.getPropertyValue(`--${name}`).trim();
    this.theme = Object.fromEntries(
      ["ground", "sector", "ring", "text", "soft", "focus", "far", "weak", "none"].map((name) => [name, value(name)]));
    this.palette = Array.from({ length: COLOURS }, (_, n) =>
      `oklch(${value("light")} ${value("chroma")} ${45 + 250 * n / (COLOURS - 1)})`);
  }

  colour(metres) {
    return this.palette[Math.min(COLOURS - 1, Math.floor(metres / REACH * COLOURS))];
  }

  resized() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    this.ask();
  }

  // Draws once before the next frame, however often it is asked.
  ask() {
    this.asked ??= requestAnimationFrame(() => { this.asked = null; this.draw(); });
  }

  // The directions that are measured, in radians.
  sector() {
    const step = 2 * Math.PI / 1024;
    const { start, end } = this.scan ?? { start: 44, end: 725 };
    return { from: (start - 384) * step, to: (end - 384) * step };
  }

  // Pixels a metre and the sensor's place that show the whole sector.
  fitted() {
    const { from, to } = this.sector();
    let [left, right, top, bottom] = [-0.3, 0.3, 0.3, -0.3];
    for (let n = 0; n <= 60; n++) {
      const angle = from + (to - from) * n / 60;
      const [x, y] = [-Math.sin(angle) * LABELS, Math.cos(angle) * LABELS];
      [left, right] = [Math.min(left, x), Math.max(right, x)];
      [top, bottom] = [Math.max(top, y), Math.min(bottom, y)];
    }
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [across, down] = [Math.max(width - 52, 50), Math.max(height - 36, 50)];
    const scale = Math.min(across / (right - left), down / (top - bottom));
    return { scale, x: width / 2 - scale * (left + right) / 2, y: height / 2 + scale * (top + bottom) / 2 };
  }

  current() { return this.view ?? this.fitted(); }

  // Zooms by a factor, with the point (x, y) of the canvas staying in place.
  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const view = this.current();
    const fit = this.fitted().scale;
    const scale = Math.min(Math.max(view.scale * factor, fit / 2), fit * 60);
    const by = scale / view.scale;
    this.view = { scale, x: x + (view.x - x) * by, y: y + (view.y - y) * by };
    this.ask();
  }

  pan(dx, dy) {
    const view = this.current();
    this.view = { ...view, x: view.x + dx, y: view.y + dy };
    this.ask();
  }

  fit() { this.view = null; this.ask(); }

  place(angle, metres, view = this.current()) {
    return [view.x - Math.sin(angle) * metres * view.scale, view.y - Math.cos(angle) * metres * view.scale];
  }

  angle(index) { return this.scan.angle_min + index * this.scan.angle_increment; }

  // Which point is meant by a place on the canvas: the nearest one close by,
  // else the one in that direction. An angle, or null outside of the sector.
  pick(x, y) {
    if (!this.scan) return null;
    const view = this.current();
    let [best, closest] = [null, 14];
    this.scan.values.forEach((value, index) => {
      if (value < 20 || value >= 4095) return;
      const [px, py] = this.place(this.angle(index), value / 1000, view);
      const away = Math.hypot(px - x, py - y);
      if (away < closest) [best, closest] = [index, away];
    });
    if (best !== null) return this.angle(best);
    const index = this.indexOf(Math.atan2(view.x - x, view.y - y));
    return index === null ? null : this.angle(index);
  }

  indexOf(angle) {
    if (!this.scan || angle === null) return null;
    const index = Math.round((angle - this.scan.angle_min) / this.scan.angle_increment);
    return index >= 0 && index < this.scan.values.length ? index : null;
  }

  draw() {
    const { context, canvas, theme } = this;
    const ratio = canvas.width / (canvas.clientWidth || 1);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    const view = this.current();
    this.grid(view);
    if (this.scan) {
      context.globalAlpha = this.stale ? 0.35 : 1;
      this.points(view);
      context.globalAlpha = 1;
      this.choice(view);
    }
    const [x, y] = [view.x, view.y];
    context.fillStyle = theme.text;
    context.beginPath();
    context.moveTo(x, y - 7); context.lineTo(x + 5, y + 5); context.lineTo(x - 5, y + 5);
    context.fill();
  }

  // An arc of the sector, for lines along one distance.
  arc(view, metres, from, to) {
    this.context.arc(view.x, view.y, metres * view.scale, -Math.PI / 2 - to, -Math.PI / 2 - from);
  }

  grid(view) {
    const { context, theme } = this;
    const { from, to } = this.sector();
    context.fillStyle = theme.sector;
    context.beginPath(); context.moveTo(view.x, view.y); this.arc(view, REACH, from, to); context.fill();
    context.strokeStyle = theme.ring;
    context.lineWidth = 1;
    context.beginPath();
    for (const angle of [from, to]) { context.moveTo(view.x, view.y); context.lineTo(...this.place(angle, REACH, view)); }
    const marks = [];
    for (let d = -120; d <= 120; d += 30) if (d >= degrees(from) - 1 && d <= degrees(to) + 1) marks.push(d);
    for (const d of marks) {
      const angle = d * Math.PI / 180;
      if (Math.abs(d) === 120) continue;
      context.moveTo(...this.place(angle, 0.15, view)); context.lineTo(...this.place(angle, REACH, view));
    }
    context.stroke();
    const step = [0.05, 0.1, 0.2, 0.5, 1, 2].find((step) => step * view.scale >= 36) ?? 4;
    const rings = Array.from({ length: Math.round(REACH / step) }, (_, n) => (n + 1) * step);
    for (const ring of rings) { context.beginPath(); this.arc(view, ring, from, to); context.stroke(); }

    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.textAlign = "center"; context.textBaseline = "middle";
    for (const d of marks) this.label(`${d > 0 ? "+" : ""}${d}°`.replace("-", "−"), ...this.place(d * Math.PI / 180, LABELS, view));
    const along = Math.min(Math.max(0, from), to);
    for (const ring of rings) {
      const [x, y] = this.place(along, ring, view);
      this.label(`${Number(ring.toFixed(2))} m`, x, y);
    }
  }

  // Text that stays readable on lines.
  label(text, x, y) {
    const { context, theme } = this;
    context.lineWidth = 4; context.lineJoin = "round";
    context.strokeStyle = theme.ground; context.strokeText(text, x, y);
    context.fillStyle = theme.soft; context.fillText(text, x, y);
    context.lineWidth = 1; context.strokeStyle = theme.ring;
  }

  points(view) {
    const { context, scan } = this;
    const size = Math.min(Math.max(view.scale / 28, 1.6), 4);
    const half = scan.angle_increment / 2;
    scan.values.forEach((value, index) => {
      const angle = this.angle(index);
      const { kind, distance } = meaning(value);
      if (kind === "distance") {
        const [x, y] = this.place(angle, distance, view);
        context.fillStyle = this.colour(distance);
        context.beginPath(); context.arc(x, y, size, 0, 2 * Math.PI); context.fill();
        return;
      }
      context.strokeStyle = this.theme[kind];
      context.lineWidth = { far: 4, weak: 6, none: 2 }[kind];
      const width = kind === "weak" ? half / 2 : half * 1.1;
      context.beginPath(); this.arc(view, MARKS[kind], angle - width, angle + width); context.stroke();
    });
  }

  choice(view) {
    const index = this.indexOf(this.chosen);
    if (index === null) return;
    const { context, theme } = this;
    const angle = this.angle(index);
    const { kind, distance } = meaning(this.scan.values[index]);
    context.strokeStyle = theme.focus; context.lineWidth = 1.5;
    context.setLineDash([4, 4]);
    context.beginPath(); context.moveTo(view.x, view.y);
    context.lineTo(...this.place(angle, distance ?? MARKS[kind], view)); context.stroke();
    context.setLineDash([]);
    context.beginPath(); context.arc(...this.place(angle, distance ?? MARKS[kind], view), 7, 0, 2 * Math.PI); context.stroke();
  }
}
