"""Publishes where networks come, go and are several: which addresses are used, what two
publishers of one name do, and what a reader costs that hangs.

networks.py PROGRAM RECORDING. Beside the namespace of `urg` there is another, `far`, with
the readers and the router: a0 (10.1.0.1) leads to it, and a1 (10.2.0.1).
"""

import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

from common import PROGRAM, Urg, ok, wait
from namespaces import ROUTER, ZENOH, Lines, Namespace, ip, use

ROS_READER = """
import sys, rclpy
from sensor_msgs.msg import LaserScan
rclpy.init()
node = rclpy.create_node("reader")
print("ready", flush=True)
got = lambda _: print(node.count_publishers("/scan"), flush=True)
node.create_subscription(LaserScan, "/scan", got, 100, raw=True)
rclpy.spin(node)
"""

# Prints the publisher and the number of each scan. Hangs after so many.
ZENOH_READER = ZENOH + """
left = int(sys.argv[2])
def take(sample):
    global left
    number, _, _, gid = struct.unpack("<qqB16s", bytes(sample.attachment))
    print(gid.hex(), number, flush=True)
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGSTOP)
listen = ["tcp/0.0.0.0:0"] if sys.argv[1] == "peer" else []
reader = session(sys.argv[1], connect_endpoints=["tcp/10.1.0.2:7447"], listen_endpoints=listen)
subscriber = reader.declare_subscriber("*/**/sensor_msgs::msg::dds_::LaserScan_/*", take)
print("ready", flush=True)
time.sleep(3600)
"""


class Sniffer:
    """What is sent on an interface: IPv4 packets that leave."""

    def __init__(self, interface):
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800))
        self.socket.bind((interface, 0x0800))
        self.socket.setblocking(False)

    def sent(self):
        packets = []
        try:
            while True:
                data, (_, _, kind, *_) = self.socket.recvfrom(65536)
                if kind == socket.PACKET_OUTGOING:
                    packets.append(data)
        except BlockingIOError:
            # Those of IGMP are the system's own. From an address to itself nothing leaves.
            return [p for p in packets if p[9] != 2 and p[12:16] != p[16:20]]


def groups(interface):
    """Returns the number of multicast groups that were joined on it."""
    text = Path("/proc/net/igmp").read_text()
    block = re.search(rf"^\d+\t{interface}\s.*\n((?:\t.*\n)*)", text, re.M)
    # 224.0.0.1 is joined on each.
    return len([line for line in block[1].splitlines() if "010000E0" not in line]) if block else 0


def sockets(process, kind):
    """Returns local address and state of its sockets of a kind, as /proc/net has them."""
    own = set()
    for fd in Path(f"/proc/{process.pid}/fd").iterdir():
        try:
            own.add(os.readlink(fd))
        except FileNotFoundError:
            pass
    rows = [line.split() for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]]
    return [
        (socket.inet_ntoa(bytes.fromhex(row[1][:8])[::-1]), row[3])
        for row in rows
        if f"socket:[{row[9]}]" in own
    ]


LISTEN = "0A"


def dds_uses_one_interface(far):
    other, loopback = Sniffer("a1"), Sniffer("lo")
    reader = Lines(ROS_READER, namespace=far)
    with Urg("publish", "emulated", "--interface", "10.1.0.1") as urg:
        reader.more()
        assert other.sent() == [] and loopback.sent() == [], "something was sent elsewhere"
        assert groups("a0") > 0 and groups("a1") == 0 and groups("lo") == 0
        assert sockets(urg.process, "tcp") == []
    reader.kill()
    ok("DDS sends on one interface, and is in the groups of no other")


def zenoh_uses_one_address(far):
    reader = Lines(ZENOH_READER, "client", "0", namespace=far)
    options = ["--engine", "zenoh", "--router", "tcp/10.1.0.2:7447", "--interface", "10.1.0.1"]
    for mode, listens in (("client", []), ("peer", ["10.1.0.1"])):
        other, loopback = Sniffer("a1"), Sniffer("lo")
        with Urg("publish", "emulated", *options, "--mode", mode) as urg:
            reader.more()
            assert other.sent() == [] and loopback.sent() == [], "something was sent elsewhere"
            tcp = sockets(urg.process, "tcp")
            assert {address for address, _ in tcp} == {"10.1.0.1"}, tcp
            assert [address for address, state in tcp if state == LISTEN] == listens, tcp
            assert sockets(urg.process, "udp") == []
    reader.kill()
    ok("zenoh uses one address; a client listens nowhere, a peer on that one")


def an_address_that_is_not_there_yet(far):
    for engine, reader in (
        ("dds", Lines(ROS_READER, namespace=far)),
        ("zenoh", Lines(ZENOH_READER, "client", "0", namespace=far)),
    ):
        options = ["--engine", engine, "--interface", "10.1.0.7"]
        options += ["--router", "tcp/10.1.0.2:7447"] if engine == "zenoh" else []
        with Urg("publish", "emulated", *options) as urg:
            urg.wait_for("cannot use the address 10.1.0.7 of --interface")
            ip("addr add 10.1.0.7/24 dev a0")
            reader.more()
            ip("addr del 10.1.0.7/24 dev a0")
            wait("the loss", lambda: urg.read().count("cannot use the address") == 2)
            ip("addr add 10.1.0.7/24 dev a0")
            reader.more()
            said = urg.stop()
            assert said.count("network is back") == 2 and len(said.splitlines()) < 8, said
        ip("addr del 10.1.0.7/24 dev a0")
        reader.kill()
    ok("an address that no interface has is waited for, at the start and later")


def dds_has_no_ipv6():
    command = [PROGRAM, "publish", "emulated", "--interface", "::1"]
    refused = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=20)
    assert refused.returncode == 2 and "expected an IPv4 address" in refused.stderr, refused


def dds_without_a_network_at_the_start():
    near, far = Namespace(), Namespace()
    ip(f"link add late type veth peer name late netns {near.process.pid}", far.enter)
    use("late", "10.3.0.2", far.enter)
    # Fast DDS looks for links only when it starts.
    ip("link set late up", near.enter)
    ip("route add 224.0.0.0/4 dev late", far.enter)
    reader = Lines(ROS_READER, namespace=far)
    with Urg("publish", "emulated", enter=near.enter) as urg:
        urg.wait_for("only readers on it get scans")
        ip("addr add 10.3.0.1/24 dev late", near.enter)
        reader.more(seconds=40)
        ip("link set late down", near.enter)
        urg.wait_for("DDS cannot send")
        ip("link set late up", near.enter)
        reader.more()
        wait("the network is back", lambda: urg.read().count("network is back") == 2)
        said = urg.stop()
        assert len(said.splitlines()) < 8, said
    for each in (reader, near, far):
        each.process.kill()
    ok("DDS uses a network that comes after it, and one that was down")


def zenoh_with_another_address():
    near = Namespace()
    near.link("a2", "10.8.0.1")
    use("a2", "10.8.0.2")
    router = Lines(ROUTER)
    reader = Lines(ZENOH_READER.replace("10.1.0.2", "127.0.0.1"), "client", "0")
    options = ["--engine", "zenoh", "--router", "tcp/10.8.0.2:7447"]
    with Urg("publish", "emulated", *options, enter=near.enter) as urg:
        reader.more()
        ip("addr del 10.8.0.1/24 dev a2", near.enter)
        time.sleep(0.1)
        ip("addr add 10.8.0.3/24 dev a2", near.enter)
        begin = time.monotonic()
        reader.more()
        took = time.monotonic() - begin
        assert took < 8, f"20 scans after {took:.1f} s"
        # The first session closes for 10 s, beside the second one: it must send nothing more.
        reader.more(120)
        publishers = [publisher for publisher, _ in reader.lines]
        changes = sum(a != b for a, b in zip(publishers, publishers[1:]))
        assert changes == 1, f"{changes} changes between {set(publishers)}"
        assert len({tuple(line) for line in reader.lines}) == len(reader.lines), "a scan came twice"
        assert "this machine has another address" in urg.stop()
    for each in (reader, router, near):
        each.process.kill()
    ok(f"a zenoh client continues with another address: 20 scans after {took:.1f} s")


def dds_says_which_interfaces_it_uses():
    near = Namespace()
    for number in range(5):
        near.link(f"f{number}", f"10.9.{number}.1")
        ip(f"link set f{number} up")
    with Urg("publish", "emulated", enter=near.enter) as urg:
        urg.wait_for("DDS uses only ")
        used, other = re.search("uses only (.*), and not (.*): choose", urg.said).groups()
        addresses = {*used.split(", "), other}
        assert addresses == {f"10.9.{number}.1" for number in range(5)}, urg.said
    near.process.kill()
    ok("DDS says which four of five interfaces it uses")


def two_publishers_of_one_name(far):
    reader = Lines(ROS_READER, namespace=far)
    with Urg("publish", "emulated", "--interface", "10.1.0.1") as first:
        with Urg("publish", "emulated", "--interface", "10.1.0.1") as second:
            wait("both", lambda: reader.lines and reader.lines[-1] == ["2"], 40)
            begin = time.monotonic()
            reader.more(60)
            took = time.monotonic() - begin
            assert took < 5, f"60 scans of two sensors took {took:.1f} s"
            second.stop()
        reader.more()
    reader.kill()
    reader = Lines(ZENOH_READER, "client", "0", namespace=far)
    options = ["emulated", "--engine", "zenoh", "--router", "tcp/10.1.0.2:7447"]
    with Urg("publish", *options) as first, Urg("publish", *options) as second:
        reader.more(60)
        publishers = {gid for gid, _ in reader.lines[-20:]}
        assert len(publishers) == 2, publishers
        second.stop()
        reader.more()
        assert len({gid for gid, _ in reader.lines[-10:]}) == 1
    reader.kill()
    ok("two publishers of one name both publish; readers can tell them apart")


def resident(process):
    """Returns the memory of a process in kB."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())[1])


def a_zenoh_reader_that_hangs(far):
    # Forty sensors soon fill the buffers of the hung reader's connection, some MB.
    sensors = [f"s{number}=emulated" for number in range(40)]
    for mode in ("client", "peer"):
        options = ["--engine", "zenoh", "--router", "tcp/10.1.0.2:7447", "--mode", mode]
        options += ["--interface", "10.1.0.1", "--window", "full"]
        with Urg("publish", *sensors, *options) as urg:
            good = Lines(ZENOH_READER, mode, "0", namespace=far)
            hung = Lines(ZENOH_READER, mode, "100", namespace=far)
            good.more(400)
            before, begin = resident(urg.process), len(good.lines)
            good.more(4000, 60)
            grown = resident(urg.process) - before
            assert len(hung.lines) < 200, "it does not hang"
            assert grown < 8_192, f"{mode}: the memory has grown by {grown} kB"
            lost = 0
            by_publisher = {}
            for gid, number in good.lines[begin:]:
                last = by_publisher.get(gid)
                lost += int(number) - last - 1 if last else 0
                by_publisher[gid] = int(number)
            assert lost == 0, f"{mode}: the other reader lost {lost} scans"
            good.kill(), hung.kill()
    ok("a zenoh reader that hangs costs the others nothing, and no memory")


far = Namespace()
far.link("a0", "10.1.0.2")
far.link("a1", "10.2.0.2")
use("a0", "10.1.0.1")
use("a1", "10.2.0.1")
router = Lines(ROUTER, namespace=far)
dds_has_no_ipv6()
dds_without_a_network_at_the_start()
dds_uses_one_interface(far)
zenoh_uses_one_address(far)
an_address_that_is_not_there_yet(far)
zenoh_with_another_address()
dds_says_which_interfaces_it_uses()
two_publishers_of_one_name(far)
a_zenoh_reader_that_hangs(far)
router.kill()
far.process.kill()
os._exit(0)
