//! An idle link over TCP: the driver's CPU time, and when it notices that the server has
//! disappeared. `benches/idle.sh` runs it against a server in a network namespace of its
//! own, counts the bytes, and makes the server disappear.
//!
//! `cargo bench --bench idle -- tcp://HOST:PORT probe|keepalive|polls SECONDS`: with the
//! driver's idle probe, without it, or with scans at 10 Hz. Prints each state with the
//! time since the start, and ends early once the link is lost and found again.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

use std::time::{Duration, Instant};

use tokio::time::timeout;
use tokio_scip::{Endpoint, Rate, Sensor, State, Window};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let [endpoint, mode, seconds] = &arguments[..] else {
        println!("not run: it needs a server, see benches/idle.sh");
        return;
    };
    let span = Duration::from_secs(seconds.parse().unwrap());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(watch(endpoint.parse().unwrap(), mode, span));
}

async fn watch(endpoint: Endpoint, mode: &str, span: Duration) {
    let mut builder = Sensor::builder();
    if mode != "probe" {
        builder = builder.idle_probe(None);
    }
    let sensor = builder.open(endpoint).await.unwrap();
    let _polls = match mode {
        "polls" => Some(sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap()),
        _ => None,
    };
    let (start, cpu) = (Instant::now(), cpu_time());
    let mut states = sensor.watch_state();
    let mut was_lost = false;
    while let Ok(changed) = timeout(span.saturating_sub(start.elapsed()), states.changed()).await {
        let state = changed.unwrap();
        println!("{:6.1} s: {state:?}", start.elapsed().as_secs_f64());
        let is_connected = matches!(state, State::Connected { .. });
        if was_lost && is_connected {
            break;
        }
        was_lost |= !is_connected;
    }
    let (elapsed, cpu) = (start.elapsed(), cpu_time() - cpu);
    println!("CPU {:.1} ms in {:.0} s", cpu.as_secs_f64() * 1e3, elapsed.as_secs_f64());
}

/// Returns the CPU time of this thread, which runs all of the driver (Linux).
fn cpu_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    Duration::from_nanos(text.split(' ').next().unwrap().parse().unwrap())
}
