"""What the scripts share: packages in a temporary folder, and the comparison at the end."""

import atexit
import ctypes
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
# Definition of the message, and what a scan of three points has besides its ranges.
LASER_SCAN = "\n".join([
    "std_msgs/Header header",
    *(f"float32 {name}" for name in ["angle_min", "angle_max", "angle_increment", "time_increment", "scan_time",
                                     "range_min", "range_max"]),
    "float32[] ranges", "float32[] intensities",
    "=" * 80, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id",
    "=" * 80, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec",
])
LIMITS = {"angle_min": -1.5, "angle_max": 1.5, "angle_increment": 1.5, "scan_time": 0.1, "range_min": 0.02,
          "range_max": 5.6}


def pypi(*packages):
    """Installs packages such as `mcap==1.6.0`, which the script may import afterwards."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
           "--root-user-action", "ignore"]
    subprocess.run([*pip, "--target", PLACE / "pypi", *packages], check=True)
    sys.path.insert(0, str(PLACE / "pypi"))
    return PLACE / "pypi"


def ros(*packages):
    """Installs packages of ROS on Fast DDS, and returns their Python. They share folders, which `pip --target` cannot do."""
    python = PLACE / "venv/bin/python"
    subprocess.run([sys.executable, "-m", "venv", PLACE / "venv"], check=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", *packages], check=True)
    os.environ.update(ROS_DOMAIN_ID="7", RMW_IMPLEMENTATION="rmw_fastrtps_cpp", ROS_LOG_DIR=str(PLACE))
    return python


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


def mrpt(program, package, links, extra=(), folders=()):
    """Builds a program with a package of MRPT 2.5.8, its dependencies and `extra` ones. Returns the command to run it.

    `links` names MRPT's libraries, and `folders` further ones of Debian's libraries."""
    simulated = ["apt-get", "install", "--simulate", "--no-install-recommends", f"{package}=1:2.5.8+ds-2"]
    plan = subprocess.run(simulated, capture_output=True, text=True, check=True).stdout
    root = debian(*[line.split()[1] for line in plan.splitlines() if line.startswith("Inst ")], *extra)
    libraries = os.environ["LD_LIBRARY_PATH"]
    parts = [f"{libraries}/{folder}" for folder in ("blas", "lapack", *folders)]
    os.environ["LD_LIBRARY_PATH"] = ":".join([libraries, *parts, f"{root}/usr/lib"])
    (PLACE / "program.cpp").write_text(program)
    includes = [root / "usr/include", root / "usr/include/eigen3", *root.glob("usr/include/mrpt/*/include")]
    linked = [next(root.glob(f"usr/lib/*/libmrpt-{name}.so.2.5")) for name in links]
    subprocess.run(["g++", "-std=c++17", *[f"-I{path}" for path in includes], "-o", PLACE / "program",
                    PLACE / "program.cpp", *linked, "-Wl,--allow-shlib-undefined"], check=True)
    return PLACE / "program"


def ser2net():
    """Unpacks ser2net with what it needs."""
    root = debian("ser2net=4.3.11-1", "libgensio4=2.6.2-4", "libwrap0=7.6.q-32", "libnsl2=1.3.0-2",
                  "libtirpc3=1.3.3+ds-1", "libyaml-0-2=0.2.5-1", "libsctp1=1.0.19+dfsg-2",
                  "libavahi-client3=0.8-10+deb12u1", "libavahi-common3=0.8-10+deb12u1",
                  "libdbus-1-3=1.14.10-1~deb12u1")
    parts = f"usr/libexec/{platform.machine()}-linux-gnu/gensio/2.6.2"
    os.environ["GENSIO_LIBRARY_PATH"] = str(root / parts)


def network():
    """Leaves for a network of its own, with the address 10.0.0.1."""
    user = os.getuid()
    # A namespace of users, too, to be root in it.
    if ctypes.CDLL(None).unshare(0x5000_0000):
        sys.exit("this system permits no namespaces")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    for words in [("link", "set", "lo", "up", "multicast", "on"), ("address", "add", "10.0.0.1", "dev", "lo"),
                  ("route", "add", "224.0.0.0/4", "dev", "lo")]:
        ip(*words)


def ip(*words):
    subprocess.run(["ip", *words], check=True)


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
