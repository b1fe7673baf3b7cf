#!/usr/bin/env python3
"""Takes the pictures of README.md from the emulated sensor: draw.py URG, where URG is the program.

Needs chromium, chromedriver, rsvg-convert, and pyte and pillow from PyPI."""

import base64
import fcntl
import json
import os
import pathlib
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
import urllib.request

import pyte
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
COLUMNS, ROWS = 80, 26
# Size of a character of the terminal.
WIDTH, HEIGHT = 8, 16
SECONDS = 8
DRIVER_PORT = 9519
# Where the page shows the two people of the room after SECONDS, in pixels.
PEOPLE = [(288, 250), (370, 264)]
LABELS = """for (const [x, y] of arguments[0]) {
    const label = document.body.appendChild(document.createElement("span"));
    label.textContent = "person";
    label.style = `position:fixed; left:${x}px; top:${y}px; transform:translate(-50%,-50%); font-weight:bold`;
}"""


def screen_of_view(urg):
    """Runs `urg view` in a terminal for some seconds."""
    child, terminal = pty.fork()
    if child == 0:
        os.environ.update(TERM="xterm-256color", COLORTERM="truecolor")
        os.execv(urg, [urg, "view", "emulated"])
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
    screen = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.ByteStream(screen)
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        if select.select([terminal], [], [], 0.2)[0]:
            stream.feed(os.read(terminal, 65536))
    os.kill(child, signal.SIGINT)
    os.close(terminal)
    os.waitpid(child, 0)
    return screen


def braille(character):
    """Yields the places of the dots of a braille character."""
    bits = ord(character) - 0x2800
    for bit, (x, y) in enumerate([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]):
        if bits >> bit & 1:
            yield x, y


def terminal(urg):
    """Draws the screen. Braille is drawn as dots, because fonts differ in its width."""
    texts, dots = [], {}
    screen = screen_of_view(urg)
    for row in range(ROWS):
        for column in range(COLUMNS):
            cell = screen.buffer[row][column]
            colour = "#d0d7de" if cell.fg == "default" else "#" + cell.fg
            x, y = column * WIDTH + 8, row * HEIGHT + 8
            if "\u2800" <= cell.data <= "\u28ff":
                for dx, dy in braille(cell.data):
                    dots.setdefault(colour, []).append(f"M{x + 1 + 4 * dx} {y + 1 + 4 * dy}h2.5v2.5h-2.5z")
            elif cell.data.strip():
                last = texts[-1] if texts else None
                if last and last[:2] == (y, colour) and last[2] + len(last[3]) * WIDTH == x:
                    last[3].append(cell.data)
                else:
                    texts.append((y, colour, x, [cell.data]))
    width, height = COLUMNS * WIDTH + 16, ROWS * HEIGHT + 16
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}">',
        "<title>urg view emulated: the walls of a room as seen from above, with rings each metre</title>",
        "<style>text { font: 13px monospace; white-space: pre }</style>",
        f'<rect width="{width}" height="{height}" rx="6" fill="#0d1117"/>',
    ]
    for y, colour, x, characters in texts:
        text = "".join(characters).replace("&", "&amp;").replace("<", "&lt;")
        length = f' textLength="{len(characters) * WIDTH}"' if len(characters) > 1 else ""
        parts.append(f'<text x="{x}" y="{y + 12}" fill="{colour}"{length}>{text}</text>')
    for colour, path in dots.items():
        parts.append(f'<path fill="{colour}" d="{"".join(path)}"/>')
    (HERE / "terminal.svg").write_text("\n".join(parts) + "\n</svg>\n")


def shrink(name):
    """Reduces a picture to the few colours that it has."""
    path = HERE / name
    Image.open(path).convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


def page(urg):
    """Photographs the page once its browser has a scan."""
    server = subprocess.Popen([urg, "serve", "emulated", "--listen", "0"], stderr=subprocess.PIPE, text=True)
    line = server.stderr.readline()
    url = next(word for word in line.split() if word.startswith("http://")).rstrip(";,.")
    driver = subprocess.Popen(["chromedriver", f"--port={DRIVER_PORT}"], stdout=subprocess.PIPE, text=True)
    while "started successfully" not in driver.stdout.readline():
        pass
    arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
                 "--disable-background-networking", "--window-size=960,760"]
    options = {"browserName": "chrome", "goog:chromeOptions": {"args": arguments}}
    session = call("POST", "", {"capabilities": {"alwaysMatch": options}})["sessionId"]
    call("POST", f"/{session}/url", {"url": url})
    time.sleep(SECONDS)
    call("POST", f"/{session}/execute/sync", {"script": LABELS, "args": [PEOPLE]})
    picture = call("GET", f"/{session}/screenshot")
    (HERE / "page.png").write_bytes(base64.b64decode(picture))
    call("DELETE", f"/{session}")
    driver.kill()
    server.send_signal(signal.SIGINT)
    server.wait()
    shrink("page.png")


def call(method, path, body=None):
    """Sends a WebDriver command."""
    data = None if body is None else json.dumps(body).encode()
    url = f"http://127.0.0.1:{DRIVER_PORT}/session{path}"
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"}, method=method)
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)["value"]


def scan(urg):
    drawing = subprocess.run([urg, "scan", "emulated", "--format", "svg"], check=True, capture_output=True).stdout
    subprocess.run(["rsvg-convert", "--width", "700", "--output", HERE / "scan.png"], input=drawing, check=True)
    shrink("scan.png")


if __name__ == "__main__":
    program = str(pathlib.Path(sys.argv[1]).resolve())
    terminal(program)
    scan(program)
    page(program)
