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
use tokio_scip::ros::MessageType;

use super::counts::ScanCounts;
use super::engine::{
    DIAGNOSTICS_TOPIC, Engine, EngineSettings, Health, MessagePublisher, NodePublishers, NodeSpec,
    STATIC_TRANSFORMS_TOPIC,
};
use crate::failure::chain;
use crate::output::notice::notice;

/// Minimum queue of a viewer. The queue also holds the server's channel announcements.
const MIN_BACKLOG: usize = 64;

/// Server with the channels of all nodes.
pub(super) struct Foxglove {
    server: WebSocketServerHandle,
    address: SocketAddr,
    /// Keeps the channels alive.
    _context: Arc<Context>,
}

impl Engine for Foxglove {
    type Memory = ();

    fn open(
        settings: &EngineSettings,
        nodes: &[NodeSpec],
        counts: &[Arc<ScanCounts>],
        (): &(),
    ) -> Result<(Self, Vec<NodePublishers>), String> {
        let failed = |error: FoxgloveError| {
            format!("cannot serve Foxglove on {}: {}", settings.listen, chain(&error))
        };
        let context = Context::new();
        let channel = |topic: &str, message: &MessageType| {
            let schema = Schema::new(message.name(), "ros2msg", message.definition().as_bytes());
            let builder = ChannelBuilder::new(topic).message_encoding("cdr").schema(schema);
            builder.context(&context)
        };
        let transforms = settings
            .static_transforms()
            .map(|message| {
                let channel = channel(STATIC_TRANSFORMS_TOPIC, &MessageType::TF_MESSAGE);
                let channel = channel.build_raw().map_err(failed)?;
                Ok::<_, String>(LateViewers { channel, message })
            })
            .transpose()?;
        // One topic shared by all nodes, as in ROS.
        let diagnostics = channel(DIAGNOSTICS_TOPIC, &MessageType::DIAGNOSTIC_ARRAY);
        let diagnostics = diagnostics.build_raw().map_err(failed)?;
        let publishers = nodes
            .iter()
            .zip(counts)
            .map(|(node, counts)| {
                let name = format!("{}/{}", node.namespace.trim_end_matches('/'), node.name);
                let scans = channel(&node.scan_topic, &MessageType::LASER_SCAN);
                let scans = scans.add_metadata("node", &name).build_raw().map_err(failed)?;
                Ok(NodePublishers {
                    scans: Box::new(ChannelPublisher {
                        channel: scans,
                        counts: Arc::clone(counts),
                    }),
                    diagnostics: Box::new(ChannelPublisher {
                        channel: Arc::clone(&diagnostics),
                        // Only scans are counted.
                        counts: Arc::default(),
                    }),
                })
            })
            .collect::<Result<Vec<_>, String>>()?;
        let mut server = WebSocketServer::new()
            .name(concat!("urg ", env!("CARGO_PKG_VERSION")))
            .context(&context)
            .message_backlog_size((settings.depth * nodes.len()).max(MIN_BACKLOG))
            .bind(host(settings.listen), settings.listen.port());
        if let Some(transforms) = transforms {
            server = server.listener(Arc::new(transforms));
        }
        let server = server.start_blocking().map_err(failed)?;
        let address = SocketAddr::new(settings.listen.ip(), server.port());
        notice(format_args!("Foxglove and Lichtblick can connect to ws://{address}"));
        Ok((Self { server, address, _context: context }, publishers))
    }

    fn look(&mut self) -> Health {
        // The SDK silently stops listening when the system cannot accept a connection, for
        // example because too many files are open. Starting it again closes them.
        match TcpListener::bind(self.address) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => Health::Works,
            Err(error) => Health::Dead(format!("the server for Foxglove has failed: {error}")),
            Ok(_) => Health::Dead("the server for Foxglove no longer listens".to_owned()),
        }
    }

    fn close(self) {
        // Closes all connections, without waiting: a client that never starts the WebSocket
        // handshake would block the exit.
        drop(self.server.stop());
    }
}

/// Publisher of one channel.
struct ChannelPublisher {
    channel: Arc<RawChannel>,
    counts: Arc<ScanCounts>,
}

impl MessagePublisher for ChannelPublisher {
    fn publish(&self, message: Vec<u8>) {
        self.channel.log(&message);
        self.counts.add_published();
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

/// Host part of an address, as the SDK joins it with the port.
fn host(address: SocketAddr) -> String {
    match address {
        SocketAddr::V4(address) => address.ip().to_string(),
        SocketAddr::V6(address) => format!("[{}]", address.ip()),
    }
}
