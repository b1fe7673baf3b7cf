"""What the scripts share: packages in a temporary folder, and the comparison at the end."""

import atexit
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PLACE = Path(tempfile.mkdtemp())
atexit.register(shutil.rmtree, PLACE, ignore_errors=True)


def pypi(*packages):
    """Installs packages such as `mcap==1.6.0`, which the script may import afterwards."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
           "--root-user-action", "ignore"]
    subprocess.run([*pip, "--target", PLACE / "pypi", *packages], check=True)
    sys.path.insert(0, str(PLACE / "pypi"))
    return PLACE / "pypi"


def npm(*packages):
    """Installs packages such as `@mcap/core@2.2.2`. Returns the folder to run `node` in."""
    folder = PLACE / "npm"
    folder.mkdir()
    (folder / "package.json").write_text("{}")
    subprocess.run(["npm", "install", "--silent", *packages], cwd=folder, check=True)
    return folder


def cargo(program, *packages):
    """Builds a program with crates such as `mcap = "=0.26.0"`. Returns the command to run it."""
    folder = PLACE / "cargo"
    (folder / "src").mkdir(parents=True)
    manifest = ["[package]", 'name = "program"', 'edition = "2021"', "[dependencies]", *packages]
    (folder / "Cargo.toml").write_text("\n".join(manifest))
    (folder / "src/main.rs").write_text(program)
    command = ["cargo", "build", "--quiet", "--target-dir", folder / "target"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "target/debug/program"


def debian(*packages):
    """Unpacks packages such as `socat=1.7.4.4-2`. Returns their root, which programs find."""
    root = PLACE / "debian"
    root.mkdir()
    subprocess.run(["apt-get", "--quiet=2", "download", *packages], cwd=root, check=True,
                   stderr=subprocess.DEVNULL)
    for package in root.glob("*.deb"):
        subprocess.run(["dpkg", "-x", package, root], check=True)
    libraries = f"{root}/usr/lib/{platform.machine()}-linux-gnu"
    os.environ["LD_LIBRARY_PATH"] = libraries
    os.environ["PATH"] = f"{root}/usr/bin:{root}/usr/sbin:{os.environ['PATH']}"
    return root


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def run(*command, **options):
    """Runs a program until the script ends, and waits for nothing."""
    process = subprocess.Popen(command, **options)
    atexit.register(process.wait)
    atexit.register(process.kill)
    return process


def connect(port):
    """Connects as soon as the program listens."""
    for _ in range(200):
        try:
            return socket.create_connection(("127.0.0.1", port), timeout=30)
        except ConnectionRefusedError:
            time.sleep(0.1)
    sys.exit(f"nobody listens on {port}")


def compare(seen, expected):
    """Prints what was seen. Ends with 1 if it is not what is expected here."""
    for what, value in seen.items():
        print(f"{what}: {value!r}")
    if seen != expected:
        sys.exit(f"changed: it was {expected!r}")
