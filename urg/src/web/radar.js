// Radar: draws scans, independent of their source. The front is up, and angles count to
// the left, seen from the sensor's top. Each layer is a sensor: its scan, its trail, its
// place in the common frame (metres, radians, upside down or not), and its colour if there
// are several sensors.

// Each layer has what its sensor measures (geometry), its values that are no distance (codes), and
// the radius of its sector (reach). The server defines them before the first scan (GEOMETRY, REACH),
// the radii of smaller pictures (RADII) and how long one lasts (HOLD), the widths of bands that share
// a colour (WIDTHS), the number of colours (BANDS), the part of the radius that they cover
// (COVERED), and the binary logarithm of the intensity where their shades begin (WEAKEST).

// Directions without a distance are marked outside the sector, on one track per kind, in
// pixels.
const TRACK = 6;
const TRACKS = { none: 3, weak: 10, far: 17 };
const LABELS = 36;

const degrees = (radians) => radians * 180 / Math.PI;

// Meaning of a sensor's raw value: a "distance" in metres, or the reason why it is missing.
function meaning({ geometry, codes }, value) {
  const code = codes[value];
  if (code) return { kind: code.kind, text: `no distance, code ${value}: ${code.meaning}` };
  if (value > geometry.max_distance) return { kind: "far", text: "no distance: saturated" };
  return { kind: "distance", distance: value / 1000, text: `${(value / 1000).toFixed(3)} m` };
}

// Shade of an intensity: each is twice the one before.
const shade = (intensity) => Math.min(BANDS - 1, Math.max(0, 31 - Math.clz32(intensity) - WEAKEST));

// Converts the index of a point to its direction in the sensor's frame, and back.
const angleOf = (scan, index) => scan.angle_min + index * scan.angle_increment;
function indexOf(scan, angle) {
  if (!scan || angle === null) return null;
  const index = Math.round((angle - scan.angle_min) / scan.angle_increment);
  return index >= 0 && index < scan.values.length ? index : null;
}

// Converts a direction in the sensor's frame to one in the common frame, and back.
const bearing = (pose, angle) => pose.yaw + (pose.upsideDown ? -angle : angle);
const bearingBack = (pose, angle) => pose.upsideDown ? pose.yaw - angle : angle - pose.yaw;

const ORIGIN = { pose: { x: 0, y: 0, yaw: 0, upsideDown: false }, geometry: GEOMETRY, reach: REACH };

class Radar {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.layers = [];
    this.chosen = null; // { layer, angle in radians }
    this.trail = false;
    this.view = null; // null: fitted
    this.themed();
    new ResizeObserver(() => this.resized()).observe(canvas);
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { this.themed(); this.requestDraw(); });
  }

  themed() {
    const style = getComputedStyle(document.documentElement);
    const value = (name) => style.getPropertyValue(`--${name}`).trim();
    this.theme = Object.fromEntries(
      ["ground", "sector", "ring", "text", "soft", "focus", "far", "weak", "none", "s0", "s1", "s2", "s3", "s4", "s5"]
        .map((name) => [name, value(name)]));
    const each = (colour) => Array.from({ length: BANDS }, (_, n) => colour(n));
    this.palette = each((n) => value(`d${n}`));
    this.shades = { null: each((n) => value(`i${n}`)) }; // by a layer's colour
    for (let s = 0; s < 6; s++) {
      const part = (n) => 30 + 70 * n / (BANDS - 1);
      this.shades[`s${s}`] = each((n) => `color-mix(in oklab, ${value(`s${s}`)} ${part(n)}%, ${this.theme.sector})`);
    }
  }

  // Metres that share a colour.
  get band() {
    const reach = Math.max(...this.layers.map(({ reach }) => reach), 0) || REACH;
    return WIDTHS.find((width) => BANDS * width >= COVERED * reach) ?? WIDTHS.at(-1);
  }

  colour(metres, band) {
    return this.palette[Math.min(BANDS - 1, Math.floor(metres / band))];
  }

  get several() { return this.layers.length > 1; }

  resized() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    this.requestDraw();
  }

  // Draws once before the next frame, however often it is called.
  requestDraw() {
    this.requested ??= requestAnimationFrame(() => { this.requested = null; this.draw(); });
  }

  // Directions that a layer measures, in radians in its sensor's frame.
  sector({ scan, window, geometry }) {
    const { steps_per_revolution, first_step, last_step, front_step } = geometry;
    const step = 2 * Math.PI / steps_per_revolution;
    const { start, end } = scan ?? window ?? { start: first_step, end: last_step };
    return { from: (start - front_step) * step, to: (end - front_step) * step };
  }

  // Scale (pixels per metre) and place of the origin that show all sectors and their rims.
  fitted() {
    let [left, right, top, bottom] = [-0.3, 0.3, 0.3, -0.3];
    const layers = this.layers.length ? this.layers : [ORIGIN];
    for (const layer of layers) {
      const { from, to } = this.sector(layer);
      for (let n = -1; n <= 60; n++) {
        const [range, angle] = n < 0 ? [0, 0] : [layer.reach, bearing(layer.pose, from + (to - from) * n / 60)];
        const x = layer.pose.x + Math.cos(angle) * range;
        const y = layer.pose.y + Math.sin(angle) * range;
        [left, right] = [Math.min(left, -y), Math.max(right, -y)];
        [top, bottom] = [Math.max(top, x), Math.min(bottom, x)];
      }
    }
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [across, down] = [Math.max(width - 2 * LABELS - 40, 50), Math.max(height - 2 * LABELS - 16, 50)];
    const scale = Math.min(across / (right - left), down / (top - bottom));
    return { scale, x: width / 2 - scale * (left + right) / 2, y: height / 2 + scale * (top + bottom) / 2 };
  }

  current() { return this.view ?? this.fitted(); }

  // Zooms by a factor, and keeps the point (x, y) of the canvas in place.
  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const view = this.current();
    const fit = this.fitted().scale;
    const scale = Math.min(Math.max(view.scale * factor, fit / 2), fit * 60);
    const by = scale / view.scale;
    this.view = { scale, x: x + (view.x - x) * by, y: y + (view.y - y) * by };
    this.requestDraw();
  }

  pan(dx, dy) {
    const view = this.current();
    this.view = { ...view, x: view.x + dx, y: view.y + dy };
    this.requestDraw();
  }

  fit() { this.view = null; this.requestDraw(); }

  // Converts a sensor's direction and range to a place on the canvas.
  place({ pose }, angle, metres, view = this.current()) {
    const ahead = pose.x + Math.cos(bearing(pose, angle)) * metres;
    const left = pose.y + Math.sin(bearing(pose, angle)) * metres;
    return [view.x - left * view.scale, view.y - ahead * view.scale];
  }

  // Finds the point at a place on the canvas: the nearest point close by, else the point
  // in that direction if there is a single sensor.
  pick(x, y) {
    const view = this.current();
    let [best, closest] = [null, 14];
    for (const layer of this.layers.filter((layer) => layer.scan)) {
      layer.scan.values.forEach((value, index) => {
        const { kind, distance } = meaning(layer, value);
        if (kind !== "distance") return;
        const angle = angleOf(layer.scan, index);
        const [px, py] = this.place(layer, angle, distance, view);
        const away = Math.hypot(px - x, py - y);
        if (away < closest) [best, closest] = [{ layer, angle }, away];
      });
    }
    if (best || this.several) return best;
    const [layer] = this.layers;
    if (!layer?.scan) return null;
    const [ox, oy] = this.place(layer, 0, 0, view);
    const angle = bearingBack(layer.pose, Math.atan2(ox - x, oy - y));
    const index = indexOf(layer.scan, Math.atan2(Math.sin(angle), Math.cos(angle)));
    return index === null ? null : { layer, angle: angleOf(layer.scan, index) };
  }

  draw() {
    const { context, canvas } = this;
    const ratio = canvas.width / (canvas.clientWidth || 1);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    this.texts = [];
    const view = this.current();
    this.grid(view);
    for (const layer of this.layers) {
      if (!layer.scan) continue;
      const alpha = layer.stale ? 0.35 : 1;
      if (this.trail) layer.trail.forEach((scan, n) => {
        this.points(view, layer, scan, alpha * 0.4 * (n + 1) / layer.trail.length, 0.7);
      });
      this.points(view, layer, layer.scan, alpha, 1);
      this.marks(view, layer, alpha);
      this.nearest(view, layer, alpha);
    }
    context.globalAlpha = 1;
    this.choice(view);
    for (const layer of this.layers) this.sensor(view, layer);
    this.write();
  }

  arc(view, { pose }, metres, from, to, pixels = 0) {
    const [x, y] = this.place({ pose }, 0, 0, view);
    const [first, last] = [bearing(pose, from), bearing(pose, to)].sort((a, b) => b - a);
    this.context.arc(x, y, metres * view.scale + pixels, -Math.PI / 2 - first, -Math.PI / 2 - last);
  }

  grid(view) {
    const { context, theme } = this;
    for (const layer of this.layers) {
      const { from, to } = this.sector(layer);
      context.fillStyle = theme.sector;
      context.beginPath(); context.moveTo(...this.place(layer, 0, 0, view));
      this.arc(view, layer, layer.reach, from, to); context.fill();
    }
    const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 4, 10, 20, 40, 100, 200].find((step) => step * view.scale >= 48) ?? 400;
    if (this.several) return this.commonGrid(view, step);
    const layer = this.layers[0] ?? ORIGIN;
    const { reach } = layer;
    const { from, to } = this.sector(layer);
    context.strokeStyle = theme.ring;
    context.lineWidth = 1;
    context.beginPath();
    const origin = this.place(layer, 0, 0, view);
    for (const angle of [from, to]) { context.moveTo(...origin); context.lineTo(...this.place(layer, angle, reach, view)); }
    const marks = this.directions(from, to);
    for (const d of marks) {
      const angle = d * Math.PI / 180;
      context.moveTo(...this.place(layer, angle, reach / 28, view)); context.lineTo(...this.place(layer, angle, reach, view));
    }
    context.stroke();
    const rings = Array.from({ length: Math.floor(reach / step + 1e-9) }, (_, n) => (n + 1) * step);
    for (const ring of [...rings, reach]) { context.beginPath(); this.arc(view, layer, ring, from, to); context.stroke(); }

    const rim = reach + LABELS / view.scale;
    for (const d of marks) this.label(2, `${d}°`, [this.place(layer, d * Math.PI / 180, rim, view)]);
    // Beside the right edge, where nothing is measured.
    const outside = bearing(layer.pose, from - Math.PI / 2);
    this.ringLabels(view, layer, rings, (ring) => {
      const [x, y] = this.place(layer, from, ring, view);
      return [x - Math.sin(outside) * 22, y - Math.cos(outside) * 14];
    });
  }

  // Labels each ring at its `spot`, or where the spot is out of sight, towards the middle of the
  // canvas or to the left.
  ringLabels(view, origin, rings, spot) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const inside = ([x, y]) => x > 20 && x < width - 20 && y > 10 && y < height - 10;
    const [x, y] = this.place(origin, 0, 0, view);
    const middle = bearingBack(origin.pose, Math.atan2(x - width / 2, y - height / 2));
    for (const ring of rings) {
      const places = [spot(ring), ...[middle, Math.PI / 2].map((angle) => this.place(origin, angle, ring, view))].filter(inside);
      this.label(2, `${Number(ring.toFixed(2))} m`, places);
    }
  }

  // Directions to label: every 30 degrees, or closer in a sector that is too narrow for
  // two labels.
  directions(from, to) {
    const each = (step) => Array.from({ length: 2 * Math.floor(180 / step) + 1 }, (_, n) => (n - Math.floor(180 / step)) * step)
      .filter((d) => d >= degrees(from) && d <= degrees(to));
    return [30, 10, 5].map(each).find((found) => found.length > 1) ?? each(1);
  }

  // Rings around the common origin, and the outline of each sensor's sector.
  commonGrid(view, step) {
    const { context, theme } = this;
    const far = Math.max(...this.layers.map(({ pose, reach }) => Math.hypot(pose.x, pose.y) + reach));
    context.strokeStyle = theme.ring; context.lineWidth = 1;
    const rings = Array.from({ length: Math.floor(far / step) }, (_, n) => (n + 1) * step);
    for (const ring of rings) { context.beginPath(); this.arc(view, ORIGIN, ring, -Math.PI, Math.PI); context.stroke(); }
    context.beginPath();
    for (const [angle, metres] of [[0, far], [Math.PI / 2, far], [Math.PI, far], [-Math.PI / 2, far]]) {
      context.moveTo(view.x, view.y); context.lineTo(...this.place(ORIGIN, angle, metres, view));
    }
    context.stroke();
    for (const layer of this.layers) {
      const { from, to } = this.sector(layer);
      context.strokeStyle = theme[layer.colour]; context.globalAlpha = 0.5;
      context.beginPath(); context.moveTo(...this.place(layer, 0, 0, view));
      this.arc(view, layer, layer.reach, from, to); context.closePath(); context.stroke();
      context.globalAlpha = 1;
    }
    this.ringLabels(view, ORIGIN, rings, (ring) => this.place(ORIGIN, 0, ring, view));
  }

  // Keeps a text for `write`, which needs one of these places. Texts of a lower rank come first.
  label(rank, text, places, colour = this.theme.soft, align = "center") {
    this.texts.push({ rank, text, places, colour, align, alpha: this.context.globalAlpha });
  }

  // Writes the texts that cover no other one, readable on lines.
  write() {
    const { context, theme } = this;
    const taken = [];
    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.textBaseline = "middle"; context.lineWidth = 4; context.lineJoin = "round";
    for (const { text, places, colour, align, alpha } of this.texts.sort((a, b) => a.rank - b.rank)) {
      const width = context.measureText(text).width;
      const start = { left: 0, center: width / 2, right: width }[align];
      const isFree = ([x, y]) => taken.every((other) =>
        x - start >= other.right || x - start + width <= other.left || Math.abs(y - other.y) >= 13);
      const place = places.find(isFree);
      if (!place) continue;
      const [x, y] = place;
      taken.push({ left: x - start, right: x - start + width, y });
      context.globalAlpha = alpha; context.textAlign = align;
      context.strokeStyle = theme.ground; context.strokeText(text, x, y);
      context.fillStyle = colour; context.fillText(text, x, y);
    }
    context.globalAlpha = 1;
  }

  points(view, layer, scan, alpha, part) {
    const { context } = this;
    const size = Math.min(Math.max(view.scale / 28, 1.6), 4) * part;
    context.globalAlpha = alpha;
    // Points that are not current have no colour, as in the terminal.
    const own = layer.stale ? this.theme.none : layer.colour ? this.theme[layer.colour] : null;
    if (own) context.fillStyle = own;
    const { band } = this;
    const { intensities } = layer.stale ? {} : scan;
    const shades = this.shades[layer.colour];
    scan.values.forEach((value, index) => {
      const { kind, distance } = meaning(layer, value);
      if (kind !== "distance") return;
      const [x, y] = this.place(layer, angleOf(scan, index), distance, view);
      if (intensities) context.fillStyle = shades[shade(intensities[index])];
      else if (!own) context.fillStyle = this.colour(distance, band);
      context.beginPath(); context.arc(x, y, size, 0, 2 * Math.PI); context.fill();
    });
  }

  // Marks directions without a distance on the track of their kind. Each mark is at least
  // as wide as the track is high. The kind "none" is two thin lines.
  marks(view, layer, alpha) {
    const { context, theme } = this;
    const { scan } = layer;
    const half = Math.max(scan.angle_increment / 2, TRACK / 2 / (layer.reach * view.scale));
    context.globalAlpha = alpha;
    const draw = (kind, offset, width) => {
      context.strokeStyle = theme[kind]; context.lineWidth = width;
      context.beginPath();
      scan.values.forEach((value, index) => {
        if (meaning(layer, value).kind !== kind) return;
        const angle = angleOf(scan, index);
        const middle = -Math.PI / 2 - bearing(layer.pose, angle);
        const [x, y] = this.place(layer, 0, 0, view);
        const radius = layer.reach * view.scale + TRACKS[kind] + offset;
        const first = middle - half;
        context.moveTo(x + Math.cos(first) * radius, y + Math.sin(first) * radius);
        context.arc(x, y, radius, first, middle + half);
      });
      context.stroke();
    };
    draw("far", TRACK / 2, TRACK);
    draw("weak", TRACK / 2, TRACK);
    draw("none", 1, 2); draw("none", TRACK - 1, 2);
  }

  // Circles the nearest point, and labels it with its distance.
  nearest(view, layer, alpha) {
    const { context, theme } = this;
    const near = layer.nearest;
    if (!near) return;
    context.globalAlpha = alpha;
    const [x, y] = this.place(layer, near.angle, near.distance, view);
    context.strokeStyle = theme.text; context.lineWidth = 1.5;
    context.beginPath(); context.arc(x, y, 8, 0, 2 * Math.PI); context.stroke();
    const [ox] = this.place(layer, 0, 0, view);
    const aside = x < ox ? -12 : 12;
    this.label(1, `${near.distance.toFixed(2)} m`, [[x + aside, y]], theme.text, x < ox ? "right" : "left");
  }

  choice(view) {
    if (!this.chosen) return;
    const { layer, angle: chosen } = this.chosen;
    const index = indexOf(layer.scan, chosen);
    if (index === null) return;
    const { context, theme } = this;
    const angle = angleOf(layer.scan, index);
    const { kind, distance } = meaning(layer, layer.scan.values[index]);
    const range = distance ?? layer.reach + (TRACKS[kind] + TRACK / 2) / view.scale;
    context.strokeStyle = theme.focus; context.lineWidth = 1.5;
    context.setLineDash([4, 4]);
    context.beginPath(); context.moveTo(...this.place(layer, 0, 0, view));
    context.lineTo(...this.place(layer, angle, range, view)); context.stroke();
    context.setLineDash([]);
    context.beginPath(); context.arc(...this.place(layer, angle, range, view), 7, 0, 2 * Math.PI); context.stroke();
  }

  sensor(view, layer) {
    const { context, theme } = this;
    const [x, y] = this.place(layer, 0, 0, view);
    context.save();
    context.translate(x, y); context.rotate(-layer.pose.yaw);
    context.fillStyle = layer.colour ? theme[layer.colour] : theme.text;
    context.beginPath();
    context.moveTo(0, -8); context.lineTo(6, 6); context.lineTo(-6, 6);
    context.fill();
    context.restore();
    if (!layer.colour) return;
    const [ahead, left] = [Math.cos(layer.pose.yaw) * 20, Math.sin(layer.pose.yaw) * 26];
    const places = [1, 2, 3, 4].map((far) => [x - left * far, y - ahead * far]);
    this.label(0, layer.name, places, theme[layer.colour]);
  }
}
