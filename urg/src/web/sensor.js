// One sensor on the page: its latest scan, its state from the server, and its card of
// figures. Text from a sensor is never parsed as HTML.

const by = (id) => document.getElementById(id);
const TRAIL = 10; // scans before the latest scan

const sentence = (text) => text.charAt(0).toUpperCase() + text.slice(1);
const direction = (radians, digits = 1) => `${degrees(radians).toFixed(digits)}°`;
const time = (milliseconds) => new Date(milliseconds).toLocaleTimeString();

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

class Sensor {
  constructor(report, number, several) {
    this.name = report.name;
    const { x, y, yaw, upside_down: upsideDown } = report.pose;
    this.pose = { x, y, yaw: yaw * Math.PI / 180, upsideDown };
    this.colour = several ? `s${number % 6}` : null;
    this.scan = null;
    this.newest = null; // updated even while the picture is paused
    this.trail = [];
    this.nearest = null;
    this.reach = REACH;
    this.reachNeeded = -Infinity; // when the picture last needed this radius
    this.stale = false;
    this.came = null; // arrival of the latest scan, on this page's clock
    this.started = performance.now();
    this.card = by("card").content.firstElementChild.cloneNode(true);
    this.card.classList.toggle("recorded", report.playback !== null);
    if (this.colour) this.card.style.setProperty("--own", `var(--${this.colour})`);
    setText(this.of("name"), this.name ?? "");
    this.counted = {}; // elements, by kind
    for (const [kind, words] of KINDS) {
      const [item, mark, text, count] = ["li", "i", "span", "b"].map((name) => document.createElement(name));
      mark.dataset.kind = kind;
      setText(text, `${kind}: ${words}`);
      setText(count, "–");
      item.append(mark, text, count);
      this.card.querySelector(".codes").append(item);
      this.counted[kind] = count;
    }
    this.report = report;
  }

  get geometry() { return this.report.geometry ?? GEOMETRY; }
  get codes() { return this.report.codes ?? {}; }

  of(name) { return this.card.querySelector(`[data-of=${name}]`); }

  // Checks whether the next scan is late.
  overdue() {
    if (this.report.playback) return false;
    return performance.now() - (this.came?.at ?? this.started) > 3000 / (this.report.asked ?? 1) + 3000;
  }

  // State in a few words, and a sentence for the banner if anything is wrong.
  condition() {
    const { link, why, playback } = this.report;
    if (playback) {
      if (why) return ["bad", "Playback failed", why];
      if (playback.paused) return ["wait", "Paused", ""];
      return playback.ended ? ["wait", "At the end", ""] : ["good", "Playing", ""];
    }
    if (link === "waiting") return ["wait", "No sensor yet", "The sensor was not found yet. Looking for it…"];
    if (link === "recovering") return ["bad", "Sensor silent", "The sensor does not answer. Looking for it…"];
    if (link === "closed") return ["bad", "Sensor away", "The sensor cannot be used. The server's messages say why."];
    if (why && link !== "connected") return ["bad", "Sensor away", "The link to the sensor is lost. Waiting for it…"];
    if (why || this.overdue()) return ["bad", "No scans", "The sensor is connected, but no scan comes."];
    return ["good", "Live", ""];
  }

  receive(data) {
    // An old scan arrived before the page was opened.
    this.came = data.old ? { at: this.started, clock: data.stamp * 1000 } : { at: performance.now(), clock: Date.now() };
    this.newest = data;
  }

  // Shows the newest scan, and moves the previous scan to the trail.
  advance() {
    const scan = this.newest;
    if (!scan || scan === this.scan) return;
    const fits = (older) => older.start === scan.start && older.values.length === scan.values.length &&
      older.sequence < scan.sequence && older.sequence + 100 > scan.sequence;
    this.trail = [...this.trail, ...(this.scan ? [this.scan] : [])].filter(fits).slice(-TRAIL);
    this.scan = scan;
    const counts = Object.fromEntries(KINDS.map(([kind]) => [kind, 0]));
    this.nearest = null;
    let farthest = 0;
    scan.values.forEach((value, index) => {
      const { kind, distance } = meaning(this, value);
      if (kind !== "distance") { counts[kind]++; return; }
      farthest = Math.max(farthest, distance);
      if (!this.nearest || distance < this.nearest.distance) this.nearest = { distance, angle: angleOf(scan, index) };
    });
    this.follow(farthest);
    for (const kind in counts) setText(this.counted[kind], String(counts[kind]));
    const missing = Object.values(counts).reduce((sum, count) => sum + count, 0);
    this.figure("points", String(scan.values.length - missing), `of ${scan.values.length}`);
    if (this.nearest) this.figure("nearest", this.nearest.distance.toFixed(2), `m at ${direction(this.nearest.angle, 0)}`);
    else setText(this.of("nearest"), "–");
  }

  // Chooses a radius that shows a point so far away: it grows at once, and shrinks later.
  follow(farthest) {
    const whole = this.report.reach ?? REACH;
    const needed = Math.min(RADII.find((radius) => radius >= farthest) ?? whole, whole);
    const now = performance.now();
    if (needed < this.reach && now - this.reachNeeded < HOLD) return;
    [this.reach, this.reachNeeded] = [needed, now];
  }

  // Shows a number, with its unit or reference in small print.
  figure(name, number, rest, below) {
    const small = (text, line) => {
      const element = document.createElement("small");
      element.textContent = line ? text : ` ${text}`;
      if (line) element.className = "below";
      return element;
    };
    this.of(name).replaceChildren(number, small(rest), ...(below ? [small(below, true)] : []));
  }

  // Marks figures that are not current, and shows their time.
  setStale(stale) {
    this.stale = stale;
    this.card.classList.toggle("stale", stale);
    const since = this.of("since");
    since.hidden = !stale;
    setText(since, this.came ? `Figures as of ${time(this.came.clock)}` : "No scan yet");
  }

  // Shows the figures from the server.
  showReport() {
    const { stats, sensor, latency, jitter, asked, reached, why, window, link, baud_rate: baud, playback } = this.report;
    if (stats && !why) {
      this.figure("rate", reached ? reached.toFixed(1) : "–", asked ? `of ${Number(asked.toFixed(2))} Hz` : "Hz");
      this.of("latency").parentElement.hidden = !latency;
      if (latency) this.figure("latency", (latency.last * 1000).toFixed(0), "ms", `mean ${(latency.mean * 1000).toFixed(0)} ms`);
      if (jitter) {
        const [min, max, deviation] = [jitter.min, jitter.max, jitter.deviation].map((seconds) => seconds * 1000);
        this.figure("jitter", deviation.toFixed(1), "ms", `${min.toFixed(0)} to ${max.toFixed(0)} ms`);
      }
    }
    const malformed = stats ? Object.values(stats.malformed).reduce((sum, count) => sum + count, 0) : 0;
    // A damaged scan of a stream is also missing by the sensor's clock.
    const failed = stats ? malformed + stats.timeouts + stats.refused : 0;
    if (stats) {
      const lost = Math.max(failed, stats.lost);
      this.figure("losses", String(lost), `${lost === 1 ? "reply" : "replies"}`, `of ${stats.polls}`);
    }
    const { x, y, yaw, upside_down: upsideDown } = this.report.pose;
    const place = this.name === null ? null : `${x} m, ${y} m, ${yaw}°${upsideDown ? ", upside down" : ""}`;
    this.rows([
      ["Port", this.report.port],
      ["Place", place],
      ["Link", playback ? "recording" : link],
      ["Line", baud ? `${baud} baud` : link === "connected" ? "no baud rate" : null],
      ["Window", `steps ${window.start} to ${window.end}` + (window.cluster > 1 ? `, by ${window.cluster}` : "")],
      ["Scans", stats?.scans ?? playback?.scans],
      ["Recorded", playback && this.scan ? `${new Date(this.scan.stamp * 1000).toISOString().replace("T", " ").slice(0, 19)} UTC` : null],
      ["Not answered", stats?.timeouts],
      ["Malformed", stats ? malformed : null],
      ["Refused", stats?.refused],
      ["Lost on the way", stats ? Math.max(stats.lost - failed, 0) : null],
      ["Polls skipped", stats?.polls_skipped],
      ["Link lost", stats ? `${stats.disconnects}×` : null],
      ["Latency, longest", latency ? `${(latency.max * 1000).toFixed(0)} ms` : null],
      ["Product", sensor?.product], ["Serial number", sensor?.serial_number],
      ["Vendor", sensor?.vendor], ["Firmware", sensor?.firmware], ["Protocol", sensor?.protocol], ["Status", sensor?.status],
    ]);
  }

  rows(list) {
    this.card.querySelector(".rows").replaceChildren(...list.filter(([, value]) => value !== null && value !== undefined).flatMap(([name, value]) => {
      const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
      dt.textContent = name; dd.textContent = value;
      return [dt, dd];
    }));
  }
}
