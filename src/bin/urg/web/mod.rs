//! `urg serve` behind its command line: the pages and streams, and the addresses
//! that they are served at.

mod app;
mod guard;
mod head;
mod hub;
mod line;
mod metrics;
mod page;
mod playback;
mod recent_times;
mod scans;
mod server;
mod source;
mod state;
mod viewers;

use std::sync::Arc;

use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};
use tokio::net::TcpListener;

use self::app::App;
pub(crate) use self::hub::Hub;
pub(crate) use self::source::Source;
use self::viewers::Viewers;
use crate::interrupt::Interrupt;

/// Serves `sources` on `listener`, an address of this machine only if `loopback`,
/// until the user stops the program and all connections have ended.
pub(crate) async fn serve(
    listener: TcpListener,
    sources: Arc<[Source]>,
    loopback: bool,
    interrupt: &Interrupt,
) {
    let app = App { sources, viewers: Arc::new(Viewers::default()), interrupt: interrupt.clone() };
    let router = Router::new()
        .route("/", get(page::page))
        .route("/scans", get(scans::scans))
        .route("/state", get(state::state))
        .route("/health", get(state::health))
        .route("/metrics", get(metrics::metrics))
        .route("/playback", post(playback::playback))
        .with_state(app)
        .layer(from_fn_with_state(loopback, guard::guard));
    server::serve(listener, router, interrupt).await;
}
