//! WebSocket server for Foxglove and Lichtblick, using Foxglove's SDK. It sends the same messages
//! as on a ROS 2 network, and their definitions, so you need no ROS to view them.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, RawChannel, Schema, WebSocketServer,
    WebSocketServerHandle,
};

use super::counts::Counts;
use super::engine::{Engine, EngineSettings, OpenedEngine, Publisher, Reopen, Topic};
use crate::failure::chain;
use crate::output::notice::notice;

/// Minimum queue of a viewer. The queue also holds the server's channel announcements.
const MIN_BACKLOG: usize = 64;

pub(super) struct Foxglove {
    server: WebSocketServerHandle,
    address: SocketAddr,
    /// Keeps the channels alive.
    _context: Arc<Context>,
}

impl Engine for Foxglove {
    fn open(settings: &Arc<EngineSettings>, topics: &Arc<[Topic]>) -> OpenedEngine {
        let failed = |error: FoxgloveError| {
            format!("cannot serve Foxglove on {}: {}", settings.listen, chain(&error))
        };
        let context = Context::new();
        // Nodes that publish on the same topic share a channel, as in ROS.
        let mut channels = Vec::new();
        let mut late_viewers = None;
        for topic in topics.iter() {
            let message = &topic.message;
            let schema = Schema::new(message.name(), "ros2msg", message.definition().as_bytes());
            let mut channel =
                ChannelBuilder::new(&topic.name).message_encoding("cdr").schema(schema);
            if let Some(node) = settings.nodes.get(topic.node).filter(|_| topic.has_scans()) {
                channel = channel.add_metadata("node", &node.full_name());
            }
            let channel = channel.context(&context).build_raw().map_err(failed)?;
            if topic.is_kept {
                let message = settings.static_transforms();
                late_viewers = Some(Arc::new(LateViewers { channel, message }));
            } else {
                channels.push((channel, Arc::clone(&topic.counts)));
            }
        }
        // The SDK joins host and port with a colon.
        let ip = settings.listen.ip();
        let host = if ip.is_ipv6() { format!("[{ip}]") } else { ip.to_string() };
        let mut server = WebSocketServer::new()
            .name(concat!("urg ", env!("CARGO_PKG_VERSION")))
            .context(&context)
            .message_backlog_size((settings.depth * settings.nodes.len()).max(MIN_BACKLOG))
            .bind(host, settings.listen.port());
        if let Some(late_viewers) = late_viewers {
            server = server.listener(late_viewers);
        }
        let server = server.start_blocking().map_err(failed)?;
        let address = SocketAddr::new(settings.listen.ip(), server.port());
        notice(format_args!("Foxglove and Lichtblick can connect to ws://{address}"));
        Ok((Box::new(Self { server, address, _context: context }), Arc::new(Channels(channels))))
    }

    fn check(&mut self) -> Result<Option<String>, Reopen> {
        // The SDK silently stops listening when the system cannot accept a connection, for
        // example because too many files are open. Starting it again closes them.
        let why = match TcpListener::bind(self.address) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => return Ok(None),
            Err(error) => format!("the server for Foxglove has failed: {error}"),
            Ok(_) => "the server for Foxglove no longer listens".to_owned(),
        };
        Err(Reopen::Dead(why))
    }

    fn close(self: Box<Self>) {
        // Closes all connections, without waiting: a client that never starts the WebSocket
        // handshake would block the exit.
        drop(self.server.stop());
    }
}

/// Channels of the topics that are published all the time, with their counters.
struct Channels(Vec<(Arc<RawChannel>, Arc<Counts>)>);

impl Publisher for Channels {
    fn publish(&self, topic: usize, message: Vec<u8>) {
        if let Some((channel, counts)) = self.0.get(topic) {
            channel.log(&message);
            counts.lock().add_published();
        }
    }
}

/// Sender of the static transforms to each new viewer: they are published only once.
struct LateViewers {
    channel: Arc<RawChannel>,
    message: Vec<u8>,
}

impl ServerListener for LateViewers {
    fn on_subscribe(&self, viewer: Client, channel: ChannelView) {
        if channel.id() == self.channel.id() {
            self.channel.log_to_sink(&self.message, viewer.sink_id());
        }
    }
}
