//! `urg serve`: live page in a browser, and scans over HTTP.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use tokio::net::{TcpListener, TcpSocket};
use tokio::task::JoinSet;
use tokio_scip::Rate;

use crate::args::{LinkArgs, listen_address};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::picture::PictureArgs;
use crate::port::named::{NamedPort, PlacedPort};
use crate::web::{self, Hub, Site, SiteSource};

/// Send buffer of the system for each client, about ten scans. A slow client lags by at most
/// these scans.
const SEND_BUFFER_BYTES: u32 = 64 * 1024;
/// Number of connections that the system queues before `accept`. A client that finds the queue
/// full retries after 1 s, then after 3 s, which would delay `/health` during a burst of
/// connections.
const BACKLOG: u32 = 1024;

/// Show a live page to any browser, and scans to programs
///
/// Runs until Ctrl-C. Unplug a sensor and plug it back in: scanning resumes. All
/// viewers share one poll per period, so more viewers do not slow down the sensor. For
/// a recording, the page has pause, step, seek, speed and loop.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the addresses", after_long_help = HELP)]
pub(crate) struct Serve {
    #[command(flatten)]
    picture: PictureArgs,
    /// Address to listen on: a port number for this machine only, or ADDRESS:PORT
    ///
    /// With `0.0.0.0:8080` or `[::]:8080`, anyone on your network can read the scans and
    /// control the playback of a recording: there is no password. On a loopback address,
    /// the server refuses requests whose Host header names another host, so that no other
    /// web site can read the scans through your browser (DNS rebinding).
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080", value_parser = listen_address)]
    listen: String,
}

const HELP: &str = "\
Addresses:
  /          the page
  /scans     scans and events as they come: NDJSON as `urg stream` writes it, or
             server-sent events if requested (Accept: text/event-stream);
             /scans?max=N ends after N scans; /scans?old begins with the last scan of a
             sensor that sends none now, with the member \"old\"
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
            // Does not wait for a client that has stopped reading.
            () = interrupt.overdue() => Ok(()),
        }
    }

    async fn serve(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let polled = interrupt.unless(self.picture.polled()).await?;
        let failed = |error| Failure::of(&format!("cannot listen on {}", self.listen), &error);
        let listener = listen(&self.listen).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;

        let sources = interrupt.unless(self.sources(polled)).await?;
        let is_loopback = bound.ip().to_canonical().is_loopback();
        let site = Site::new(sources, is_loopback, interrupt);
        let hubs = site.sources().iter().filter_map(SiteSource::hub).map(Arc::clone);
        let mut going =
            Going { sources: site.sources().len(), hubs: hubs.collect(), runs: JoinSet::new() };
        for player in site.sources().iter().filter_map(SiteSource::player) {
            let player = player.clone();
            going.runs.spawn(async move { Err(player.failed().await) });
        }
        let link = &self.picture.link;
        if !link.wait {
            interrupt.unless(going.open(link)).await?;
        }
        notice(format_args!("live page on http://{bound}/, Ctrl-C ends it"));
        if !is_loopback {
            notice("there is no password: everyone who can reach this address can watch");
        }
        tokio::select! {
            outcome = going.follow(link) => outcome,
            () = web::serve(listener, site) => Ok(()),
        }
    }

    async fn sources(&self, polled: Vec<(PlacedPort, Rate)>) -> Result<Vec<SiteSource>, Failure> {
        let mut sources = Vec::new();
        for (PlacedPort { named: NamedPort { name, port }, pose }, rate) in polled {
            let name = name.as_deref();
            let window = self.picture.window.window(port.default_window())?;
            sources.push(match port.recorded() {
                Some(recorded) => {
                    let settings = self.picture.playback;
                    SiteSource::of_recording(name, pose, &port, recorded, window, settings).await?
                }
                None => SiteSource::of_sensor(name, pose, Hub::new(port, window, rate)),
            });
        }
        Ok(sources)
    }
}

/// Sources that are still running. A playback ends only when the file becomes unreadable.
struct Going {
    sources: usize,
    hubs: Vec<Arc<Hub>>,
    runs: JoinSet<Result<(), Failure>>,
}

impl Going {
    /// Opens all sensors concurrently. A sensor that cannot be opened counts as ended.
    async fn open(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        let mut opening = JoinSet::new();
        for hub in std::mem::take(&mut self.hubs) {
            let link = link.clone();
            opening.spawn(async move { hub.open(&link).await.map(|()| hub) });
        }
        while let Some(opened) = opening.join_next().await {
            // The panic hook has already printed a panic.
            match opened.unwrap_or_else(|error| Err(Failure::of("cannot open", &error))) {
                Ok(hub) => self.hubs.push(hub),
                Err(failure) => self.ended(Err(failure))?,
            }
        }
        Ok(())
    }

    /// Runs all sources until the last one ends.
    async fn follow(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        for hub in std::mem::take(&mut self.hubs) {
            let link = link.clone();
            self.runs.spawn(async move { hub.run(&link).await });
        }
        while let Some(run) = self.runs.join_next().await {
            self.ended(run.unwrap_or_else(|error| Err(Failure::of("cannot continue", &error))))?;
        }
        match self.sources {
            0 => Ok(()),
            _ => std::future::pending().await,
        }
    }

    /// Counts a source that has ended. While others continue, its error is only printed. The
    /// last source's error ends the program.
    fn ended(&mut self, outcome: Result<(), Failure>) -> Result<(), Failure> {
        self.sources = self.sources.saturating_sub(1);
        match outcome {
            Err(failure) if self.sources > 0 => {
                notice(format_args!("{}; the others continue", failure.line()));
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
    // Accepted connections inherit the size.
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}
