"""Publishes to readers of ROS 2 that are found in other ways than by multicast on one network,
and to readers that were forgotten.

discovery.py PROGRAM RECORDING
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from common import Urg, ok, wait
from namespaces import ROS_READER, Lines, Namespace, ip, use

# Announces itself each 30 s, as its lease of 40 s allows.
RARE = """
import time
from cyclonedds.domain import Domain, DomainParticipant
domain = Domain(7, "<Discovery><LeaseDuration>40s</LeaseDuration></Discovery>")
participant = DomainParticipant(7)
print("ready", flush=True)
time.sleep(3600)
"""

# Takes the ports of the first participants of a machine.
CROWD = """
import socket, time
taken = []
for index in range(int(__import__("sys").argv[1])):
    for port in (9160 + 2 * index, 9161 + 2 * index):
        taken.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        try:
            taken[-1].bind(("", port))
        except OSError:
            pass
print("ready", flush=True)
time.sleep(3600)
"""

# Preloaded, it fails a program's multicast while a file exists.
NO_MULTICAST = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <unistd.h>
ssize_t sendmsg(int fd, const struct msghdr *message, int flags) {
    ssize_t (*next)(int, const struct msghdr *, int) = dlsym(RTLD_NEXT, "sendmsg");
    const struct sockaddr_in *to = message->msg_name;
    if (to && to->sin_family == AF_INET && to->sin_addr.s_addr == htonl(0xEFFF0001) &&
        access(BLOCKED, F_OK) == 0) {
        errno = ENETUNREACH;
        return -1;
    }
    return next(fd, message, flags);
}
"""

LOCALHOST = "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
# A participant of ROS 2 is forgotten after 20 s.
LEASE = 20
PERIOD = 10**8


class Hosts:
    """Two hosts with a link between them: `near` has the sensor."""

    def __init__(self):
        self.near, self.far = Namespace(), Namespace()
        self.programs = []
        self.link("n0", "10.4.0", self.far)

    def link(self, name, network, other):
        inside = self.near.enter
        ip(f"link add {name} type veth peer name {name} netns {other.process.pid}", inside)
        for place, number in ((self.near, 1), (other, 2)):
            use(name, f"{network}.{number}", place.enter)
            ip(f"route replace 224.0.0.0/4 dev {name}", place.enter)

    def reader(self, namespace, *settings):
        return self.program(ROS_READER, namespace, *settings)

    def program(self, text, namespace, *settings, arguments=()):
        program = Lines(text, *arguments, namespace=namespace, settings=settings)
        self.programs.append(program)
        return program

    def urg(self, *settings):
        return Urg("publish", "emulated", enter=("env", *settings, *self.near.enter))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for each in (*self.programs, self.near, self.far):
            each.process.kill()
            each.process.wait()


def static_peers():
    # Multicast leads to no reader: each side asks the other's address. Hosts that are down, and
    # a name that nobody knows, do not matter.
    absent = [f"10.4.0.{number}" for number in range(3, 100)]
    peers = ";".join(["10.9.9.9", "robot.invalid", *absent, "10.4.0.2"])
    for settings in ((LOCALHOST,), ()):
        with Hosts() as hosts:
            reader = hosts.reader(hosts.far, *settings, "ROS_STATIC_PEERS=10.4.0.1")
            with hosts.urg(LOCALHOST, f"ROS_STATIC_PEERS={peers}") as urg:
                reader.more(100, 60)
                assert "static peer robot.invalid has no address" in urg.stop()
    ok("a static peer on another host gets scans, without multicast")


def localhost():
    with Hosts() as hosts:
        local, remote = hosts.reader(hosts.near), hosts.reader(hosts.far)
        with hosts.urg(LOCALHOST):
            local.more(100, 40)
        assert remote.lines == [], "a reader on another host got scans"
        # The same reader gets scans of a publisher that is not so limited.
        with hosts.urg():
            remote.more(20, 40)
    ok("with LOCALHOST readers on this host get scans, and others none")


def many_participants_on_this_machine():
    with Hosts() as hosts:
        reader = hosts.reader(hosts.near, LOCALHOST)
        crowd = hosts.program(CROWD, hosts.near, arguments=["60"])
        with hosts.urg(LOCALHOST):
            reader.more(20, 40)
        crowd.kill()
        crowd = hosts.program(CROWD, hosts.near, arguments=["120"])
        with hosts.urg(LOCALHOST) as urg:
            urg.wait_for("Failed to find a free participant index")
            urg.wait_for("too many participants run on this machine")
            crowd.kill()
            reader.more(20, 40)
    ok("the 61st participant of a machine publishes; the 120th says why not, and waits")


def a_participant_that_announces_itself_rarely():
    """Its announcements, more than 20 s apart, are no reason to open the engine again."""
    with Hosts() as hosts:
        hosts.program(RARE, hosts.far)
        with hosts.urg() as urg:
            time.sleep(65)
            said = urg.stop()
            assert len(said.splitlines()) == 1, said
    ok("a participant with a longer lease is not taken for one that was forgotten")


def a_second_interface():
    with Hosts() as hosts:
        first = hosts.reader(hosts.far)
        with hosts.urg() as urg:
            first.more(20, 40)
            second = Namespace()
            hosts.link("n1", "10.5.0", second)
            other = hosts.reader(second)
            other.more(20, 40)
            first.more(20)
            said = urg.stop()
            assert said.count("interfaces have changed") == 1 and len(said.splitlines()) == 2, said
        other.kill()
        second.process.kill()
    ok("an interface that is added while it publishes is used, and the first one still")


def reopened_for_a_forgotten_reader():
    with Hosts() as hosts:
        steady, forgotten = hosts.reader(hosts.far), hosts.reader(hosts.far)
        with hosts.urg() as urg:
            steady.more(20, 40), forgotten.more(20, 40)
            forgotten.process.send_signal(signal.SIGSTOP)
            time.sleep(LEASE + 5)
            forgotten.process.send_signal(signal.SIGCONT)
            urg.wait_for("a reader is back after a silence", 20)
            forgotten.more(20), steady.more(20)
        stamps = [int(stamp) for _, stamp in steady.lines]
        gaps = [b - a for a, b in zip(stamps, stamps[1:])]
        assert min(gaps) > 0, "a scan came twice, or late"
        missed = sum(round(gap / PERIOD) - 1 for gap in gaps)
        assert missed <= 20, f"{missed} scans are missing"
    ok(f"opened again for a reader that was forgotten: no scan came twice, {missed} are missing")


def reopened_when_announcements_cannot_be_sent():
    folder = Path(tempfile.mkdtemp())
    blocked, library = folder / "blocked", folder / "no_multicast.so"
    command = ["cc", "-shared", "-fPIC", f'-DBLOCKED="{blocked}"', "-o", str(library), "-xc", "-"]
    subprocess.run(command, input=NO_MULTICAST, text=True, check=True)
    opened_again = "DDS cannot send, but its network interfaces are up: the engine is opened again"
    with Hosts() as hosts:
        reader = hosts.reader(hosts.far)
        with hosts.urg(f"LD_PRELOAD={library}") as urg:
            # It must have worked for 5 s.
            reader.more(80, 40)
            begin = time.monotonic()
            blocked.touch()
            urg.wait_for(opened_again, 20)
            took = time.monotonic() - begin
            assert took > 4, f"opened again after {took:.1f} s"
            urg.wait_for("DDS cannot send on some network")
            blocked.unlink()
            urg.wait_for("the network is back")
            late = hosts.reader(hosts.far)
            late.more(20, 40), reader.more(20, 40)
            said = urg.stop()
            assert said.count(opened_again) == 1, said
    shutil.rmtree(folder)
    ok(f"opened again when announcements could not be sent for {took:.1f} s")


# Kilted has no Cyclone DDS.
rare = threading.Thread(target=a_participant_that_announces_itself_rarely)
if "jazzy" in sys.prefix:
    rare.start()
static_peers()
localhost()
many_participants_on_this_machine()
a_second_interface()
reopened_for_a_forgotten_reader()
reopened_when_announcements_cannot_be_sent()
if rare.ident:
    rare.join()
os._exit(0)
