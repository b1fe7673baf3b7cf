//! `urg serve` behind its command line: the pages and streams, and the addresses
//! that they are served at.

mod app;
mod guard;
mod hub;
mod metrics;
mod page;
mod scans;
mod server;
mod state;
mod viewers;

use std::sync::Arc;

use axum::Router;
use axum::middleware::from_fn_with_state;
use axum::routing::get;
use tokio::net::TcpListener;

use self::app::App;
pub(crate) use self::hub::Hub;
use self::viewers::Viewers;
use crate::interrupt::Interrupt;

/// Serves `hub` on `listener`, an address of this machine only if `loopback`,
/// until the user stops the program and all connections have ended.
pub(crate) async fn serve(
    listener: TcpListener,
    hub: &Arc<Hub>,
    loopback: bool,
    interrupt: &Interrupt,
) {
    let app = App {
        hub: Arc::clone(hub),
        viewers: Arc::new(Viewers::default()),
        interrupt: interrupt.clone(),
    };
    let router = Router::new()
        .route("/", get(page::page))
        .route("/scans", get(scans::scans))
        .route("/state", get(state::state))
        .route("/health", get(state::health))
        .route("/metrics", get(metrics::metrics))
        .with_state(app)
        .layer(from_fn_with_state(loopback, guard::guard));
    server::serve(listener, router, interrupt).await;
}
