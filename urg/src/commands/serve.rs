//! `urg serve`: live page in a browser, and scans over HTTP.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use tokio::net::{TcpListener, TcpSocket};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use crate::args::listen_address;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::picture::PictureArgs;
use crate::web::{self, Hosts, Site, SiteSource};

/// Send buffer of the system for each client: a slow one lags by at most these ten scans.
const SEND_BUFFER_BYTES: u32 = 64 * 1024;
/// Number of connections that the system queues before `accept`. A client that finds the queue full
/// retries after 1 s, then after 3 s, which would delay `/health` during a burst of connections.
const BACKLOG: u32 = 1024;

/// Show a live page to any browser, and scans to programs
///
/// Runs until Ctrl-C. Unplug a sensor and plug it back in: scanning resumes. All viewers share one poll per period,
/// so more viewers do not slow down the sensor. For a recording, the page has pause, step, seek, speed and loop.
#[derive(Debug, clap::Args)]
#[command(after_help = "`--help` explains the addresses", after_long_help = HELP)]
pub(crate) struct Serve {
    #[command(flatten)]
    picture: PictureArgs,
    /// Address to listen on: a port number for this machine only, or ADDRESS:PORT
    ///
    /// With `0.0.0.0:8080` or `[::]:8080`, anyone on your network can read the scans and
    /// control the playback of a recording: there is no password.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080", value_parser = listen_address)]
    listen: String,
    /// Another name of this machine, besides its host name and its addresses. Repeat for more
    ///
    /// The server refuses requests for unknown hosts, so that no other web site can read the
    /// scans through your browser (DNS rebinding).
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
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
counter-clockwise; write X,Y,YAW,upside-down for a sensor mounted so. The lines of
/scans then name their sensor. A sensor that fails does not affect the others.

Examples:
  urg serve /dev/ttyACM0                    then open http://127.0.0.1:8080/
  urg serve serial:H0713090 --wait --listen 0.0.0.0:8080
  urg serve front=/dev/ttyACM0@0.2,0,0 rear=serial:H0713091@-0.2,0,180
  curl -s http://127.0.0.1:8080/scans?max=1 | jq .ranges[341]";

impl Serve {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let PictureArgs { playback, link, .. } = &self.picture;
        let picture = interrupt.unless(self.picture.sources()).await?;
        let failed = |error| {
            Failure::new(format_args!("cannot listen on {}", self.listen), &error)
                .advise("--listen chooses another address, such as `--listen 8081`")
        };
        let listener = listen(&self.listen).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;

        let (opening, mut opened) = mpsc::channel(1);
        let (mut sources, mut runs) = (Vec::new(), JoinSet::new());
        for source in picture {
            let source = interrupt.unless(SiteSource::new(source, playback.clone())).await?;
            sources.push(Arc::clone(&source));
            let (link, opening) = (link.clone(), opening.clone());
            runs.spawn(async move { source.run(&link, opening).await });
        }
        drop(opening);
        if !link.wait {
            tokio::select! {
                biased;
                // First, because errors come before the address of the page.
                outcome = last(&mut runs) => return outcome,
                _ = interrupt.requested() => return Ok(()),
                // Nothing is sent: it ends when no sensor is being opened any more.
                _ = opened.recv() => {}
            }
        }
        notice(format_args!("live page on http://{bound}/, Ctrl-C ends it"));
        if !bound.ip().to_canonical().is_loopback() {
            notice("there is no password: everyone who can reach this address can watch");
        }
        let listen_host = self.listen.rsplit_once(':').map(|(host, _)| host.to_owned());
        let hosts = Hosts::new(self.hosts.into_iter().chain(listen_host));
        tokio::select! {
            outcome = last(&mut runs) => outcome,
            () = web::serve(listener, Site::new(sources, hosts, interrupt)) => Ok(()),
        }
    }
}

/// Waits until the last source ends, and returns its outcome. While others continue, an error is
/// only printed. Cancel-safe.
async fn last(runs: &mut JoinSet<Result<(), Failure>>) -> Result<(), Failure> {
    while let Some(run) = runs.join_next().await {
        // The panic hook has already printed a panic.
        match run.unwrap_or_else(|error| Err(Failure::new("cannot continue", &error))) {
            Err(failure) if !runs.is_empty() => {
                notice(format_args!("{}; the others continue", failure.line()));
            }
            outcome => outcome?,
        }
    }
    Ok(())
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
