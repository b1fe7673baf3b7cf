//! `urg serve`: a live page for any browser, and scans over HTTP.

use std::io;
use std::net::SocketAddr;

use tokio::net::{TcpListener, TcpSocket};

use crate::args::{LinkArgs, WindowArgs, default_to_loopback};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::port::name::PortArg;
use crate::web::{self, Hub};

/// The system's send buffer for each client, some ten scans: a slow client gets
/// those of the past that are in it.
const SEND_BUFFER_BYTES: u32 = 64 * 1024;

/// Show a live page to any browser, and scans to programs
///
/// Runs until Ctrl-C, also while the sensor is unplugged and when it comes back.
/// Any number of viewers costs the sensor no more than one.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the addresses", after_long_help = HELP)]
pub(crate) struct Serve {
    #[command(flatten)]
    port: PortArg,
    /// Address to listen on: a port number on this machine only, or ADDRESS:PORT
    ///
    /// `0.0.0.0:8080` and `[::]:8080` let everybody on the network look, without a
    /// password. An address of this machine only refuses requests that name another
    /// host: no page of another site can look by resolving its own name to here.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080")]
    listen: String,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10; a
    /// recording: its own pace]
    #[arg(long, value_name = "HZ")]
    rate: Option<tokio_scip::Rate>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const HELP: &str = "\
Addresses:
  /        the page
  /scans   scans and events as they come: NDJSON as `urg stream` writes it, or
           server-sent events if requested (Accept: text/event-stream);
           /scans?max=N ends after N scans
  /state   the sensor and the state of its stream, one JSON object
  /health  200 while scans flow, else 503 with the reason
  /metrics the figures of both for Prometheus

Examples:
  urg serve /dev/ttyACM0                    then open http://127.0.0.1:8080/
  urg serve serial:H0713090 --wait --listen 0.0.0.0:8080
  curl -s http://127.0.0.1:8080/scans?max=1 | jq .ranges[341]";

impl Serve {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        tokio::select! {
            outcome = self.serve(interrupt) => outcome,
            // Does not wait for a client that does not read.
            () = interrupt.overdue() => Ok(()),
        }
    }

    async fn serve(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let (port, rate) = self.port.polled_at(self.rate).await?;
        let window = self.window.window(port.default_window())?;
        let address = default_to_loopback(&self.listen);
        let failed = |error| Failure::of(&format!("cannot listen on {address}"), &error);
        let listener = listen(&address).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;

        let hub = Hub::new(port, window, rate);
        let loopback = bound.ip().to_canonical().is_loopback();
        let announce = || {
            notice(format_args!("live page on http://{bound}/, Ctrl-C ends it"));
            if !loopback {
                notice("anybody who can reach this address can look: there is no password");
            }
        };
        if self.link.wait {
            announce();
        } else {
            tokio::select! {
                opened = hub.open(&self.link) => opened?,
                _ = interrupt.requested() => return Ok(()),
            }
            announce();
        }
        tokio::select! {
            outcome = hub.run(&self.link) => outcome,
            () = web::serve(listener, &hub, loopback, interrupt) => Ok(()),
        }
    }
}

async fn listen(address: &str) -> io::Result<TcpListener> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for address in tokio::net::lookup_host(address).await? {
        match bind(address) {
            Ok(listener) => return Ok(listener),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn bind(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = match address {
        SocketAddr::V4(_) => TcpSocket::new_v4(),
        SocketAddr::V6(_) => TcpSocket::new_v6(),
    }?;
    #[cfg(unix)]
    socket.set_reuseaddr(true)?;
    // Connections inherit it.
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(128)
}
