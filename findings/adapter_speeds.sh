#!/usr/bin/env bash
# Linux 6.1 (Debian 12): two drivers of RS-232 adapters report a baud rate that the adapter does not run at.
#
# Expected of 250,000 baud, which neither chip has: an error, or the terminal then reports the speed that was set, as
# with a CP2102 at 750,000. But mos7840 chooses 403,200 and ti_usb_3410_5052 chooses 230,769, and both report 250,000.
# So a program that reads its setting back, as one should, takes a wrong speed for a silent device. The chips are a
# program of ours behind `vhci_hcd`: they compute their speed from the control requests of the real drivers. It runs in
# QEMU.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import json
import subprocess

from place import PLACE, compare, debian

PROGRAM = r"""
#include <arpa/inet.h>
#include <asm/termbits.h>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <map>
#include <string>
#include <sys/ioctl.h>
#include <sys/mount.h>
#include <sys/reboot.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>

using Bytes = std::string;

struct Chip {
    const char* driver;
    uint16_t vendor, product;
    uint8_t configuration;  // Its number: the driver of the TUSB3410 loads firmware in number 1.
    Bytes endpoints;        // Address and kind of each.
    std::map<int, int> registers;
    double speed = 0;

    // Answers a control request of the driver.
    Bytes control(uint8_t request, uint16_t value, uint16_t index, const Bytes& data, uint16_t length) {
        const std::string name = driver;
        if (name == "cp210x") {
            if (request == 0xff && value == 0x370b) return Bytes(1, 2);  // the part: CP2102
            if (request == 0x1e) memcpy(&registers[0], data.data(), 4), speed = registers[0];
        } else if (name == "ti_usb_3410_5052") {
            // Its clock is 24 MHz / 26, its divisor the first field of the settings.
            if (request == 5) speed = 24e6 / 26 / (uint8_t(data[0]) << 8 | uint8_t(data[1]));
        } else {
            // UART 1 is a 16550. Register 0 of the chip chooses its clock.
            static const double clocks[] = {115200, 230400, 403200, 460800, 806400, 921600, 1572864, 3145728};
            int place = (value & 0xff00) | index;
            if (place <= 0x101 && place >= 0x100 && registers[0x103] & 0x80) place += 0x1000;
            if (request == 0x0d) return Bytes(1, char(registers[place]));  // a read
            registers[place] = value & 0xff;
            if (const int divisor = registers[0x1101] << 8 | registers[0x1100])
                speed = clocks[registers[0] >> 4 & 7] / divisor;
        }
        return Bytes(length, 0);
    }

    Bytes descriptor(int kind) const {
        const auto low = [](int number) { return char(number & 0xff); };
        if (kind == 1)
            return {18, 1, 0, 2, 0, 0, 0, 64, low(vendor), low(vendor >> 8), low(product), low(product >> 8),
                    0, 1, 0, 0, 0, 1};
        Bytes parts = {9, 4, 0, 0, char(endpoints.size() / 2), char(0xff), 0, 0, 0};
        for (size_t at = 0; at < endpoints.size(); at += 2)
            parts += Bytes{7, 5, endpoints[at], endpoints[at + 1], 64, 0, 1};
        return Bytes{9, 2, low(9 + parts.size()), 0, 1, char(configuration), 0, char(0x80), 50} + parts;
    }

    // The far end of usbip: a header of 48 bytes, then the data. Other transfers than control wait for ever.
    void serve(int kernel) {
        uint32_t in[10];
        uint8_t setup[8];
        while (recv(kernel, in, 40, MSG_WAITALL) == 40 && recv(kernel, setup, 8, MSG_WAITALL) == 8) {
            const bool unlink = ntohl(in[0]) == 2, reads = ntohl(in[3]);
            Bytes data(unlink || reads ? 0 : ntohl(in[6]), 0), answer;
            if (!data.empty()) recv(kernel, &data[0], data.size(), MSG_WAITALL);
            if (!unlink && in[4]) continue;
            uint32_t out[12] = {htonl(unlink ? 4 : 3), in[1]};
            const uint16_t length = setup[6] | setup[7] << 8;
            if (unlink) out[5] = htonl(-104);
            else if (setup[0] & 0x60)
                answer = control(setup[1], setup[2] | setup[3] << 8, setup[4] | setup[5] << 8, data, length);
            else if (setup[1] == 6 && setup[3] < 3) answer = descriptor(setup[3]);
            else if (setup[1] == 6) out[5] = htonl(-32);
            else answer = Bytes(2, 0);
            if (!unlink) out[6] = htonl(reads ? std::min<size_t>(answer.size(), length) : data.size());
            send(kernel, out, 48, 0);
            if (reads && !unlink) send(kernel, answer.data(), ntohl(out[6]), 0);
        }
    }
};

void try_speeds(Chip chip) {
    int ends[2];
    socketpair(AF_UNIX, SOCK_STREAM, 0, ends);
    std::thread([&chip, end = ends[0]] { chip.serve(end); }).detach();
    FILE* attach = fopen("/sys/devices/platform/vhci_hcd.0/attach", "w");
    fprintf(attach, "0 %d 1 2", ends[1]);
    fclose(attach);
    int port = -1;
    for (int tries = 0; tries < 200 && port < 0; tries++)
        usleep(50000), port = open("/dev/ttyUSB0", O_RDWR | O_NOCTTY | O_NONBLOCK);
    for (unsigned request : {115200, 250000, 500000, 750000}) {
        termios2 settings;
        ioctl(port, TCGETS2, &settings);
        settings.c_cflag = (settings.c_cflag & ~(CBAUD | CBAUD << IBSHIFT)) | BOTHER | CLOCAL;
        settings.c_ispeed = settings.c_ospeed = request;
        const int failed = ioctl(port, TCSETS2, &settings);
        ioctl(port, TCGETS2, &settings);
        printf("speeds [\"%s\", %u, %u, %.0f]\n", chip.driver, request, failed ? 0 : settings.c_ospeed, chip.speed);
    }
    fflush(stdout);
    shutdown(ends[0], SHUT_RDWR);
    close(port);
    while (access("/dev/ttyUSB0", F_OK) == 0) usleep(50000);
    sleep(1);
}

int main() {
    mount("dev", "/dev", "devtmpfs", 0, nullptr), mount("sys", "/sys", "sysfs", 0, nullptr);
    for (const char* name : {"usb-common", "usbcore", "usbip-core", "vhci-hcd", "usbserial", "cp210x", "mos7840",
                             "ti_usb_3410_5052"}) {
        const int file = open((std::string("/") + name + ".ko").c_str(), O_RDONLY);
        if (syscall(SYS_finit_module, file, "", 0)) perror(name);
        close(file);
    }
    try_speeds({"cp210x", 0x10c4, 0xea60, 1, {char(0x81), 2, 1, 2}});
    try_speeds({"mos7840", 0x9710, 0x7810, 1, {char(0x81), 2, 2, 2, char(0x83), 3}});
    try_speeds({"ti_usb_3410_5052", 0x0451, 0x3410, 2, {char(0x81), 2, 1, 2, char(0x83), 3}});
    reboot(RB_POWER_OFF);
}
"""

about = ["apt-cache", "depends", "linux-image-amd64"]
depends = subprocess.run(about, capture_output=True, text=True, check=True)
kernel = next(line.split()[-1] for line in depends.stdout.splitlines() if "Depends: linux-image" in line)
root = debian(kernel)
image = next((root / "boot").glob("vmlinuz-*"))
disk = PLACE / "disk"
disk.mkdir()
for name in ("common/usb-common", "core/usbcore", "usbip/usbip-core", "usbip/vhci-hcd", "serial/usbserial",
             "serial/cp210x", "serial/mos7840", "serial/ti_usb_3410_5052"):
    next(root.glob(f"lib/modules/*/kernel/drivers/usb/{name}.ko")).rename(disk / f"{name.split('/')[1]}.ko")
for folder in ("dev", "sys"):
    (disk / folder).mkdir()
(PLACE / "program.cpp").write_text(PROGRAM)
subprocess.run(["g++", "-std=c++17", "-static", "-o", disk / "init", PLACE / "program.cpp"], check=True)
names = "\n".join(str(path.relative_to(disk)) for path in disk.rglob("*"))
pack = ["cpio", "--quiet", "-o", "-H", "newc"]
archive = subprocess.run(pack, cwd=disk, input=names.encode(), capture_output=True, check=True)
(PLACE / "initramfs").write_bytes(archive.stdout)
command = ["qemu-system-x86_64", "-nodefaults", "-nographic", "-no-reboot", "-m", "512", "-serial", "stdio",
           "-kernel", image, "-initrd", PLACE / "initramfs", "-append", "console=ttyS0 quiet panic=-1"]
done = subprocess.run(command, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL)
print(kernel)
seen = {}
for line in done.stdout.splitlines():
    if line.startswith("speeds "):
        driver, request, reported, speed = json.loads(line.removeprefix("speeds "))
        seen.setdefault(driver, {})[request] = (reported, speed)
# Of each request: what the terminal reports, and the speed of the chip.
compare(seen, {
    "cp210x": {115200: (115200, 115200), 250000: (250000, 250000), 500000: (500000, 500000),
               750000: (921600, 921600)},
    "mos7840": {115200: (115200, 115200), 250000: (250000, 403200), 500000: (500000, 806400),
                750000: (750000, 806400)},
    "ti_usb_3410_5052": {115200: (115200, 115385), 250000: (250000, 230769), 500000: (500000, 461538),
                         750000: (750000, 923077)},
})
END
