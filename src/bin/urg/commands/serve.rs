//! `urg serve`: a live page for any browser, and scans over HTTP.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use futures_util::StreamExt;
use futures_util::future::join_all;
use futures_util::stream::FuturesUnordered;
use tokio::net::{TcpListener, TcpSocket};
use tokio_scip::Rate;

use crate::args::{LinkArgs, WindowArgs, listen_address};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::playback::PlaybackArgs;
use crate::port::named::NamedPort;
use crate::port::placed::{PlacedPort, PlacedPorts};
use crate::web::{self, Hub, Source};

/// The system's send buffer for each client, some ten scans: a slow client gets
/// those of the past that are in it.
const SEND_BUFFER_BYTES: u32 = 64 * 1024;
/// The number of connections that the system keeps until they are accepted. A client
/// that finds no room tries again after 1 s, then after 3 s: in a burst of connections
/// that is the time of `/health`.
const BACKLOG: u32 = 1024;

/// Show a live page to any browser, and scans to programs
///
/// Runs until Ctrl-C, also while a sensor is unplugged and when it comes back. A sensor
/// is polled once a period for all viewers together. The page plays a recording with
/// pause, step, seek, speed and loop.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the addresses", after_long_help = HELP)]
pub(crate) struct Serve {
    #[command(flatten)]
    sensors: PlacedPorts,
    /// Address to listen on: a port number on this machine only, or ADDRESS:PORT
    ///
    /// With `0.0.0.0:8080` or `[::]:8080` everybody on the network can read the scans
    /// and control a recording's playback: there is no password. On a loopback address a request is refused if its Host
    /// header names another host, so that no other web site can read the scans through
    /// the user's browser (DNS rebinding).
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080", value_parser = listen_address)]
    listen: String,
    /// Scans a second, or `max` for as fast as the sensor answers [default: 10]
    #[arg(long, value_name = "HZ")]
    rate: Option<Rate>,
    #[command(flatten)]
    window: WindowArgs,
    #[command(flatten)]
    playback: PlaybackArgs,
    #[command(flatten)]
    link: LinkArgs,
}

const HELP: &str = "\
Addresses:
  /          the page
  /scans     scans and events as they come: NDJSON as `urg stream` writes it, or
             server-sent events if requested (Accept: text/event-stream);
             /scans?max=N ends after N scans
  /state     the sensors and the states of their streams, one JSON object
  /health    200 while the scans of all sensors arrive, else 503 with the reasons
  /metrics   the figures of all sensors for Prometheus
  /playback  control of a recording: POST /playback?pause, ?play, ?step=1,
             ?seek=12.5, ?speed=2, ?loop=true

Several sensors in one picture: NAME=PORT@X,Y,YAW, such as front=PORT@0.2,0,180. X
is in metres ahead of the common origin, Y to its left, and YAW in degrees
counter-clockwise. The lines of /scans then name their sensor. A sensor that fails
does not affect the others.

Examples:
  urg serve /dev/ttyACM0                    then open http://127.0.0.1:8080/
  urg serve serial:H0713090 --wait --listen 0.0.0.0:8080
  urg serve front=/dev/ttyACM0@0.2,0,0 rear=serial:H0713091@-0.2,0,180
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
        let mut polled = self.sensors.polled_at(self.rate).await?;
        let ports = polled.iter_mut().map(|(placed, _)| &mut placed.named.port);
        self.playback.apply(ports, self.rate.is_some())?;
        let failed = |error| Failure::of(&format!("cannot listen on {}", self.listen), &error);
        let listener = listen(&self.listen).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;

        let sources: Arc<[Source]> = tokio::select! {
            sources = self.sources(polled) => sources?.into(),
            _ = interrupt.requested() => return Ok(()),
        };
        let loopback = bound.ip().to_canonical().is_loopback();
        let announce = || {
            notice(format_args!("live page on http://{bound}/, Ctrl-C ends it"));
            if !loopback {
                notice("anybody who can reach this address can look: there is no password");
            }
        };
        let mut going = Going { sources: sources.len() };
        let mut hubs: Vec<_> = sources.iter().filter_map(Source::hub).map(Arc::clone).collect();
        if !self.link.wait {
            let opening = join_all(hubs.iter().map(|hub| hub.open(&self.link)));
            let opened = tokio::select! {
                opened = opening => opened,
                _ = interrupt.requested() => return Ok(()),
            };
            let mut found = Vec::new();
            for (hub, outcome) in hubs.into_iter().zip(opened) {
                match outcome {
                    Ok(()) => found.push(hub),
                    failed => going.ended(failed)?,
                }
            }
            hubs = found;
        }
        announce();
        tokio::select! {
            outcome = going.follow(&hubs, &self.link) => outcome,
            () = web::serve(listener, sources, loopback, interrupt) => Ok(()),
        }
    }

    async fn sources(&self, polled: Vec<(PlacedPort, Rate)>) -> Result<Vec<Source>, Failure> {
        let mut sources = Vec::new();
        for (PlacedPort { named: NamedPort { name, port }, pose }, rate) in polled {
            let name = name.as_deref();
            let window = self.window.window(port.default_window())?;
            sources.push(match port.recorded() {
                Some(recorded) => {
                    let settings = self.playback;
                    Source::of_recording(name, pose, &port, recorded, window, settings).await?
                }
                None => Source::of_sensor(name, pose, Hub::new(port, window, rate)),
            });
        }
        Ok(sources)
    }
}

/// The number of sources that have not ended. The playback of a recording never does.
struct Going {
    sources: usize,
}

impl Going {
    /// Follows the sensors until no source is left.
    async fn follow(&mut self, hubs: &[Arc<Hub>], link: &LinkArgs) -> Result<(), Failure> {
        let runs = hubs.iter().map(|hub| hub.run(link));
        let mut runs: FuturesUnordered<_> = runs.collect();
        while let Some(outcome) = runs.next().await {
            self.ended(outcome)?;
        }
        match self.sources {
            0 => Ok(()),
            _ => std::future::pending().await,
        }
    }

    /// Takes note of a sensor that has ended. Its failure is reported while others go
    /// on; that of the last one is the program's.
    fn ended(&mut self, outcome: Result<(), Failure>) -> Result<(), Failure> {
        self.sources = self.sources.saturating_sub(1);
        match outcome {
            Err(failure) if self.sources > 0 => {
                notice(format_args!("{}; the others go on", failure.line()));
                Ok(())
            }
            outcome => outcome,
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
    socket.listen(BACKLOG)
}
