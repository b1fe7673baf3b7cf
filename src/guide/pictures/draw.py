#!/usr/bin/env python3
"""Draws the pictures of the guide.

Each picture is an SVG of a few kilobytes that follows the reader's light or dark theme.
`definitions.md` holds the same pictures as data, because rustdoc copies no files."""

import math
import pathlib
import urllib.parse

HERE = pathlib.Path(__file__).resolve().parent
STYLE = """<style>
svg { color: #24292f; font: 13px Helvetica, Arial, sans-serif }
text { fill: currentColor } .dim { fill: #6e7781 } .mid { text-anchor: middle } .end { text-anchor: end }
.line { stroke: currentColor; fill: none } .thin { stroke: #8c959f; fill: none } .dash { stroke-dasharray: 4 3 }
.good { fill: #2da44e } .bad { fill: #cf222e } .blue { fill: #0969da } .fill { fill: #0969da; fill-opacity: .15 }
.box { fill: none; stroke: currentColor; rx: 6 } .goodline { stroke: #2da44e; fill: none } .badline { stroke: #cf222e; fill: none }
.blueline { stroke: #0969da; fill: none; stroke-width: 1.5 } .head { fill: currentColor }
@media (prefers-color-scheme: dark) { svg { color: #e6edf3 } .dim { fill: #9198a1 } .blue, .fill { fill: #4493f8 }
.blueline { stroke: #4493f8 } .good { fill: #3fb950 } .goodline { stroke: #3fb950 } .bad { fill: #f85149 } .badline { stroke: #f85149 } }
</style>
<defs><marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto-start-reverse"><path class="head" d="M0 0L8 4L0 8z"/></marker></defs>
"""


def save(name, width, height, title, parts):
    text = (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'height="{height}" role="img">\n<title>{title}</title>\n{STYLE}' + "\n".join(parts) + "\n</svg>\n")
    (HERE / f"{name}.svg").write_text(text)


def text(x, y, words, style=""):
    return f'<text x="{x:g}" y="{y:g}"{f" class={chr(34)}{style}{chr(34)}" if style else ""}>{words}</text>'


def line(x1, y1, x2, y2, style="line", arrow=False):
    end = ' marker-end="url(#a)"' if arrow else ""
    return f'<path class="{style}" d="M{x1:g} {y1:g}L{x2:g} {y2:g}"{end}/>'


def box(x, y, width, height, *lines, style="box"):
    middle = y + height / 2 + 5 - 8 * (len(lines) - 1)
    parts = [f'<rect class="{style}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6"/>']
    return parts + [text(x + width / 2, middle + 16 * n, words, "mid" if n == 0 else "mid dim")
                    for n, words in enumerate(lines)]


def at(step, radius, centre):
    """The place of a step in a picture in which the front is up."""
    angle = math.radians((step - 384) * 360 / 1024)
    return centre[0] - radius * math.sin(angle), centre[1] - radius * math.cos(angle)


def geometry():
    centre, radius = (310, 190), 130
    start, end = at(44, radius, centre), at(725, radius, centre)
    parts = [
        f'<path class="fill" d="M{centre[0]} {centre[1]}L{start[0]:.1f} {start[1]:.1f}A{radius} {radius} 0 1 0 {end[0]:.1f} {end[1]:.1f}z"/>',
        f'<circle class="head" cx="{centre[0]}" cy="{centre[1]}" r="4"/>',
        line(*centre, centre[0], 25, arrow=True), line(*centre, centre[0] - 165, centre[1], arrow=True),
        text(centre[0] + 8, 32, "x"), text(centre[0] - 165, centre[1] - 8, "y"),
    ]
    for step, label, anchor, dx, dy in [
        (384, "step 384: front, 0°", "", 10, 8), (640, "step 640: left, +90°", "end", -38, 18),
        (128, "step 128: right, −90°", "", 8, 4), (0, "step 0: −135°", "", 6, 14), (768, "step 768: +135°", "end", -6, 14),
        (44, "step 44: −119.5°", "", 8, 4), (725, "step 725: +119.9°", "end", -8, 4),
    ]:
        near, far = at(step, radius - 6, centre), at(step, radius + 6, centre)
        parts.append(line(*near, *far))
        parts.append(text(far[0] + dx, far[1] + dy, label, anchor))
    for step in [0, 768]:
        parts.append(line(*centre, *at(step, radius, centre), "thin dash"))
    arc_a, arc_b = at(330, 70, centre), at(438, 70, centre)
    parts += [f'<path class="line" d="M{arc_a[0]:.1f} {arc_a[1]:.1f}A70 70 0 0 0 {arc_b[0]:.1f} {arc_b[1]:.1f}" marker-end="url(#a)"/>',
              text(centre[0] + 24, 108, "steps count up", "dim"),
              text(centre[0], 240, "no data behind", "mid dim")]
    save("geometry", 620, 320, "Seen from above: x points forward and y left. Steps count counter-clockwise, from step 0 "
         "at -135 degrees over step 384 at the front to step 768 at +135 degrees. Steps 44 to 725 are measured.", parts)


def polling():
    parts, left, period = [], 90, 90
    rows = [(40, "grid"), (80, "G"), (120, "reply"), (160, "scan")]
    parts += [text(left - 20, y + 4, name, "end dim") for y, name in rows]
    for n in range(6):
        x = left + n * period
        parts += [line(x, 28, x, 175, "thin dash"), text(x, 20, f"{n * 100} ms", "mid dim")]
    # Due, sent, first and last byte of the reply, in periods.
    for sent, first, last in [(0, .25, .4), (1, 1.9, 2.35), (2.38, 2.6, 2.75), (3, 3.25, 3.4), (4, 4.25, 4.4), (5, 5.25, 5.4)]:
        x1, x2, x3 = (left + value * period for value in (sent, first, last))
        parts += [f'<path class="head" d="M{x1:g} 72l6 8l-6 8z"/>', f'<rect class="fill" x="{x2:g}" y="112" width="{x3 - x2:g}" height="16"/>',
                  f'<circle class="good" cx="{x3:g}" cy="160" r="5"/>']
    late = left + 2 * period
    parts.append(f'<circle class="bad" cx="{late}" cy="40" r="4"/>')
    parts += [f'<circle class="good" cx="{left + n * period}" cy="40" r="4"/>' for n in (0, 1, 3, 4, 5)]
    parts += [text(late + 22, 205, "the poll of 200 ms waits for the line,", "dim"),
              text(late + 22, 221, "then the grid continues", "dim"), line(late + 34, 190, late + 34, 96, "thin", True)]
    save("polling", 590, 235, "A time line of polls. Polls lie on a grid of 100 ms. The reply to the second poll is slow, so the "
         "third poll is sent late, as soon as the line is free. The fourth is on the grid again.", parts)


def recovery():
    parts = []
    parts += box(20, 60, 130, 50, "Connecting", "open the port")
    parts += box(240, 60, 130, 50, "Connected", "polls and scans")
    parts += box(460, 60, 170, 50, "Recovering", "try every baud rate")
    parts += box(340, 190, 170, 50, "Disconnected", "wait 0.1 to 1 s, reopen")
    parts += box(60, 190, 130, 50, "Closed", "the stream ends")
    parts += [
        line(150, 85, 236, 85, arrow=True), line(370, 75, 456, 75, arrow=True), line(460, 97, 374, 97, arrow=True),
        text(415, 52, "three fences", "mid dim"), text(415, 66, "unanswered", "mid dim"), text(415, 114, "found", "mid dim"),
        line(330, 110, 400, 186, arrow=True), text(358, 152, "hang-up", "end dim"),
        line(520, 110, 450, 186, arrow=True), text(498, 152, "not found", "dim"),
        '<path class="line" d="M425 240C425 285 300 285 262 114" marker-end="url(#a)"/>', text(300, 268, "the sensor is back", "end dim"),
        '<path class="line" d="M250 110L150 186" marker-end="url(#a)"/>', text(168, 140, "last handle", "end dim"), text(158, 156, "dropped", "end dim"),
    ]
    save("recovery", 650, 290, "States of the connection. Connecting leads to Connected. Three unanswered fences lead to Recovering, "
         "and back once the sensor is found. A hang-up, or a sensor that is not found, leads to Disconnected, and back to "
         "Connected when the sensor returns. Dropping the last handle leads to Closed.", parts)


def fence():
    host, sensor, parts = 200, 500, []
    parts += [text(host, 20, "driver", "mid"), text(sensor, 20, "sensor", "mid"), line(host, 30, host, 300, "thin"), line(sensor, 30, sensor, 300, "thin")]
    def message(y1, y2, words, style="line", back=False):
        a, b = (sensor - 4, host + 4) if back else (host + 4, sensor - 4)
        parts.append(line(a, y1, b, y2, style, True))
        parts.append(text(350, (y1 + y2) / 2 - 6, words, "mid"))
    message(45, 60, "G 44..725")
    parts += [line(host - 6, 110, host + 6, 110), text(host - 14, 106, "deadline passed:", "end"), text(host - 14, 122, "send a fence", "end")]
    message(115, 130, "G 7..7, the fence")
    message(150, 175, "late: 44..725", "badline", True)
    parts.append(text(host - 14, 180, "dropped", "end bad"))
    message(190, 205, "7..7", "goodline", True)
    parts.append(text(host - 14, 210, "nothing older can follow", "end good"))
    message(230, 245, "G 43..725")
    message(265, 285, "43..725", "goodline", True)
    parts.append(text(host - 14, 290, "a scan", "end good"))
    save("fence", 540, 310, "A fence. A reply is late, its deadline passes, and the driver requests a single step. The late reply comes "
         "and is dropped. The reply to the fence comes after it, so nothing older can follow. The next reply is a scan.", parts)


def time():
    parts, left, period, late = [], 40, 120, (6, 12, 3, 55, 8)
    rows = [(34, "the motor: revolutions end at equal distances"), (94, "arrivals: never early, late by a USB frame or a busy host"),
            (154, "the driver's line, along the earliest arrivals")]
    for y, words in rows:
        parts += [text(left, y, words), line(left, y + 18, 620, y + 18, "thin")]
    for n, delay in enumerate(late):
        x = left + 50 + n * period
        parts += [line(x, top, x, bottom, "thin dash") for top, bottom in ((44, 80), (100, 140), (160, 180))]
        parts += [f'<circle class="head" cx="{x}" cy="52" r="5"/>',
                  f'<rect class="{"bad" if delay > 50 else "blue"}" x="{x + delay}" y="104" width="3" height="16"/>',
                  f'<rect class="good" x="{x + 2}" y="164" width="3" height="16"/>']
    x = left + 50 + 3 * period
    parts += [line(x + 3, 194, x + late[3], 194, "badline"), text(x + late[3] + 8, 198, "lateness of this scan", "dim")]
    save("time", 640, 214, "Revolutions end at equal distances. Replies arrive later, by different times. The driver's line runs along the "
         "earliest arrivals and shows how late each scan is.", parts)


geometry()
polling()
recovery()
fence()
time()
(HERE / "definitions.md").write_text("".join(
    f"[{path.stem} picture]: data:image/svg+xml,{urllib.parse.quote(path.read_text(), safe='')}\n"
    for path in sorted(HERE.glob("*.svg"))
))
