#!/usr/bin/env bash
# In the log of a service `journalctl -o json` (systemd 252) shows `null` for each scan, and rsyslog 8.2302 cuts it.
#
# Expected: a line of NDJSON can be read from the log as it was written; journald keeps lines of up to 48 kB. journalctl
# shows `null` instead of a message of more than 4,087 bytes, unless called with `--all`. rsyslog keeps 8,096 bytes of a
# line of a file: the scans of a URG pass, the ones of a UST do not, unless `maxMessageSize` is set.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import os
import subprocess
import time

from place import PLACE, compare, debian, run

# An event, and scans of 682 and 1,081 points.
LINES = [json.dumps({"event": "disconnected"})]
LINES += [json.dumps({"values": [1234] * points, "ranges": [1.234] * points}, separators=",:")
          for points in (682, 1081)]
LIMIT = ["-" * 4087, "-" * 4088]


def journal(lines, *options):
    """Returns how long each line is if a journal has it, and is read with these options."""
    entries = [f"__REALTIME_TIMESTAMP={number}000000\n_BOOT_ID={1:032}\nMESSAGE={line}\n\n"
               for number, line in enumerate(lines, 1)]
    file = PLACE / "urg.journal"
    file.unlink(missing_ok=True)
    subprocess.run([root / "lib/systemd/systemd-journal-remote", "-o", file, "-"], input="".join(entries).encode(),
                   stderr=subprocess.DEVNULL, check=True)
    read = [root / "bin/journalctl", "--file", file, "-o", "json", *options]
    messages = [json.loads(line)["MESSAGE"] for line in subprocess.run(read, capture_output=True).stdout.splitlines()]
    return [message and len(message) for message in messages]


def rsyslog(name, *options):
    """Returns how long each line is if rsyslog reads it from a file."""
    source, log, file = [PLACE / f"{name}.{end}" for end in ("ndjson", "log", "conf")]
    source.write_text("".join(line + "\n" for line in LINES))
    file.write_text("\n".join([
        *options, f'global(workDirectory="{PLACE}")', 'module(load="imfile")',
        f'input(type="imfile" File="{source}" Tag="urg:")', 'template(name="line" type="string" string="%msg%\\n")',
        f'if $syslogtag == "urg:" then action(type="omfile" file="{log}" template="line")']))
    modules = f"{os.environ['LD_LIBRARY_PATH'].split(':')[0]}/rsyslog"
    run(root / "usr/sbin/rsyslogd", "-n", "-f", file, "-i", PLACE / f"{name}.pid", "-M", modules)
    for _ in range(100):
        lines = log.read_text().splitlines() if log.exists() else []
        if len(lines) == len(LINES):
            break
        time.sleep(0.1)
    return [len(line) for line in lines]


root = debian("systemd=252.39-1~deb12u2", "libsystemd-shared=252.39-1~deb12u2",
              "systemd-journal-remote=252.39-1~deb12u2", "libmicrohttpd12=0.9.75-6", "rsyslog=8.2302.0-1+deb12u2",
              "libestr0=0.1.11-1", "libfastjson4=1.2304.0-1", "liblognorm5=2.0.6-4")
os.environ["LD_LIBRARY_PATH"] += f":{os.environ['LD_LIBRARY_PATH']}/systemd"
compare({
    "lines": [len(line) for line in LINES],
    "journalctl -o json": journal(LINES),
    "journalctl -o json --all": journal(LINES, "--all"),
    "journalctl -o json at its limit": journal(LIMIT),
    "rsyslog": rsyslog("defaults"),
    "rsyslog with maxMessageSize": rsyslog("longer", 'global(maxMessageSize="64k")'),
}, {
    "lines": [25, 7525, 11914],
    "journalctl -o json": [25, None, None],
    "journalctl -o json --all": [25, 7525, 11914],
    "journalctl -o json at its limit": [4087, None],
    "rsyslog": [25, 7525, 8096],
    "rsyslog with maxMessageSize": [25, 7525, 11914],
})
END
