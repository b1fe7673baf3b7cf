// Controls for the playback of a recording. The server runs the playback, and all
// viewers share it.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 50];

class Deck {
  constructor() {
    this.status = null; // of the first recording; null without a recording
    this.wanted = null; // the command to send next
    this.busy = false;
    for (const speed of SPEEDS) by("speed").append(new Option(`${speed}×`, speed));
    by("back").onclick = () => this.send("step=-1");
    by("play").onclick = () => this.send("toggle");
    by("on").onclick = () => this.send("step=1");
    by("loop").onclick = () => this.send(`loop=${!this.status.loop}`);
    by("speed").onchange = () => this.send(`speed=${by("speed").value}`);
    by("seek").oninput = () => this.send(`scan=${by("seek").value}`);
  }

  // Sends a command. Later commands wait, and only the last of them is sent.
  async send(command) {
    if (this.busy) { this.wanted = command; return; }
    this.busy = true;
    try {
      await fetch(`/playback?${command}`, { method: "POST", signal: AbortSignal.timeout(3000) });
    } catch { /* the banner says that the server is away */ }
    this.busy = false;
    if (this.wanted) this.send(this.wanted);
    this.wanted = null;
  }

  update(status) {
    this.status = status;
    by("deck").hidden = by("deckkeys").hidden = !status;
    by("pause").hidden = Boolean(status);
    if (!status) return;
    by("play").setAttribute("aria-pressed", String(status.paused || status.ended));
    by("loop").setAttribute("aria-pressed", String(status.loop));
    by("seek").max = status.scans - 1;
    if (![...by("speed").options].some((option) => Number(option.value) === status.speed)) {
      by("speed").append(new Option(`${status.speed}×`, status.speed));
    }
    by("speed").value = status.speed;
    this.moveTo(status.scan, status.position);
  }

  // Shows the position, unless the user is moving the slider.
  moveTo(scan, position) {
    if (!this.status) return;
    if (!by("seek").matches(":active")) by("seek").value = scan;
    setText(by("clock"), `${this.clock(position)} of ${this.clock(this.status.length)}`);
  }

  clock(seconds) {
    const tenths = Math.floor(seconds * 10 + 0.05);
    const two = (number) => String(number).padStart(2, "0");
    const [hours, minutes] = [Math.floor(tenths / 36000), Math.floor(tenths / 600) % 60];
    const rest = `${two(Math.floor(tenths / 10) % 60)}.${tenths % 10}`;
    return hours ? `${hours}:${two(minutes)}:${rest}` : `${minutes}:${rest}`;
  }

  // Action of a key, if the deck uses the key.
  key(key, onRadar) {
    if (!this.status) return null;
    const faster = (by) => () => this.send(`speed=${Math.min(Math.max(this.status.speed * by, 0.1), 100)}`);
    const keys = {
      " ": () => this.send("toggle"), ",": () => this.send("step=-1"), ".": () => this.send("step=1"),
      "[": faster(0.5), "]": faster(2), o: () => this.send(`loop=${!this.status.loop}`),
      ...(onRadar ? {} : { ArrowLeft: () => this.send("by=-5"), ArrowRight: () => this.send("by=5") }),
    };
    return keys[key] ?? null;
  }
}
