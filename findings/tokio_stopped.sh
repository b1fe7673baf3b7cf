#!/usr/bin/env bash
# tokio 1.54.1 (crates.io): after a pause of the program, a read with a timeout fails although its bytes are there.
#
# A signal stops the program for three seconds, as a debugger or Ctrl-Z does. Meanwhile the other side of a TCP
# connection sends five bytes. Expected of `timeout(1 s, socket.read(...))`: the bytes, because it polls the read
# before it checks its time. But the pause ends tokio's wait without an event, so that it fires timers before it
# learns of the bytes. A second read, without a timeout, has them at once. With several threads it depends on
# which one is faster.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import signal
import socket
import subprocess
import time

from place import cargo, compare

READ = """
use std::time::Duration;
use tokio::{io::AsyncReadExt, net::TcpStream, time::timeout};

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let port: u16 = std::env::args().nth(1).unwrap().parse().unwrap();
    let mut socket = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    let mut bytes = [0; 16];
    println!("reading");
    match timeout(Duration::from_secs(1), socket.read(&mut bytes)).await {
        Ok(read) => println!("{} bytes", read.unwrap()),
        Err(elapsed) => println!("{elapsed}, then {} bytes", socket.read(&mut bytes).await.unwrap()),
    }
}
"""

program = cargo(READ, 'tokio = { version = "=1.54.1", features = ["full"] }')


def read(stop):
    with socket.create_server(("127.0.0.1", 0)) as server:
        reader = subprocess.Popen([program, str(server.getsockname()[1])], stdout=subprocess.PIPE, text=True)
        with server.accept()[0] as link:
            reader.stdout.readline()
            time.sleep(0.3)
            if stop:
                reader.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            link.sendall(b"bytes")
            time.sleep(3)
            reader.send_signal(signal.SIGCONT)
            return reader.communicate()[0].strip()


seen = {"not stopped": read(False), "stopped": read(True)}
compare(seen, {
    "not stopped": "5 bytes",
    "stopped": "deadline has elapsed, then 5 bytes",
})
END
