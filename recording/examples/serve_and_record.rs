//! A service that serves, streams and records one sensor at once. A client begins and ends a
//! recording while the sensor is in use:
//!
//! ```sh
//! cargo run -p urg-recording --example serve_and_record emulated /tmp 127.0.0.1:8082
//! curl http://127.0.0.1:8082/nearest             # of the newest scan
//! curl -N http://127.0.0.1:8082/scans            # a line for each scan
//! curl -X POST http://127.0.0.1:8082/recording   # begins one, named after the time
//! curl -X DELETE http://127.0.0.1:8082/recording # ends it
//! ```
//!
//! All clients and the recording share the polls of one stream.

#[path = "../../examples/port/mod.rs"]
mod port;

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::SystemTime;

use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::{get, post};
use futures::StreamExt;
use tokio::net::TcpListener;
use tokio::sync::{Mutex, oneshot};
use tokio::task::JoinHandle;
use tokio_scip::{Rate, Scan, ScanStream, Sensor, Window};
use urg_recording::{Progress, Recorder, RecordingError};

/// Number of scans that wait for the recorder.
const DEPTH: usize = 100;

type Refusal = (StatusCode, String);

struct Service {
    sensor: Sensor,
    scans: ScanStream,
    folder: PathBuf,
    recording: Mutex<Option<Running>>,
}

/// Recording in progress.
struct Running {
    end: oneshot::Sender<()>,
    task: JoinHandle<Result<Progress, RecordingError>>,
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(2).ok_or("expected a port and a folder")?.into();
    let sensor = port::open(Sensor::builder(), &port::argument()).await?;
    let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).depth(DEPTH).await?;
    let service = Service { sensor, scans, folder, recording: Mutex::new(None) };
    let address = std::env::args().nth(3).unwrap_or("127.0.0.1:8082".to_owned());
    let listener = TcpListener::bind(address).await?;
    println!("listening on http://{}/nearest", listener.local_addr()?);
    let router = Router::new()
        .route("/nearest", get(nearest))
        .route("/scans", get(stream_scans))
        .route("/recording", post(begin).delete(end))
        .with_state(Arc::new(service));
    Ok(axum::serve(listener, router).await?)
}

fn line(scan: &Scan) -> String {
    let nearest = scan.nearest().map_or("null".to_owned(), |point| point.range.to_string());
    format!("{{\"scan\":{},\"nearest\":{nearest}}}\n", scan.sequence())
}

async fn nearest(State(service): State<Arc<Service>>) -> Result<String, Refusal> {
    let scan = service.scans.latest();
    scan.map(|scan| line(&scan))
        .ok_or_else(|| (StatusCode::SERVICE_UNAVAILABLE, "no scan yet\n".to_owned()))
}

/// Each client has a place of its own in the stream, and a slow one misses scans.
async fn stream_scans(State(service): State<Arc<Service>>) -> Body {
    let lines = service
        .scans
        .resubscribe()
        .filter_map(|item| async move { item.ok().map(|scan| Ok::<_, Infallible>(line(&scan))) });
    Body::from_stream(lines)
}

async fn begin(State(service): State<Arc<Service>>) -> Result<String, Refusal> {
    let mut recording = service.recording.lock().await;
    if recording.is_some() {
        return Err((StatusCode::CONFLICT, "a recording runs already\n".to_owned()));
    }
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let path = service.folder.join(format!("{}.mcap", now.as_millis()));
    let failed =
        |error: &dyn std::error::Error| (StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n"));
    let mut recorder = Recorder::create(&path).map_err(|error| failed(&error))?;
    recorder.observe(&service.sensor);
    let scans = service.scans.resubscribe();
    recorder.describe(&service.sensor, &scans).await.map_err(|error| failed(&error))?;
    let (end, ended) = oneshot::channel();
    *recording = Some(Running { end, task: tokio::spawn(record(recorder, scans, ended)) });
    Ok(format!("{}\n", path.display()))
}

async fn end(State(service): State<Arc<Service>>) -> Result<String, Refusal> {
    let running = service.recording.lock().await.take();
    let Running { end, task } =
        running.ok_or((StatusCode::CONFLICT, "no recording runs\n".to_owned()))?;
    // Fails if the recording has ended already, because the disk is full.
    let _ = end.send(());
    match task.await {
        Ok(Ok(progress)) => Ok(format!("{} scans\n", progress.scans)),
        Ok(Err(error)) => Err((StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n"))),
        Err(error) => Err((StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n"))),
    }
}

/// Records until the client ends it, also while the sensor is away.
async fn record(
    mut recorder: Recorder,
    mut scans: ScanStream,
    mut ended: oneshot::Receiver<()>,
) -> Result<Progress, RecordingError> {
    loop {
        tokio::select! {
            _ = &mut ended => break,
            item = scans.next() => match item {
                Some(item) => recorder.record(&item)?,
                None => break,
            },
        }
    }
    recorder.finish().await
}
