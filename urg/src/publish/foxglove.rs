//! WebSocket server for Foxglove and Lichtblick, using Foxglove's SDK. It sends the same messages
//! as on a ROS 2 network, and their definitions, so you need no ROS to view them.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use foxglove::{ChannelBuilder, Context, FoxgloveError, Schema, WebSocketServer};
use urg_recording::ros::MessageType;

use super::engine::{Engine, EngineSettings, Opened, Reopen, Unavailable};
use super::send_queue::SendQueue;
use crate::failure::chain;
use crate::output::notice::notice;

/// Minimum queue of a viewer. The queue also holds the server's channel announcements.
const MIN_BACKLOG: usize = 64;

pub(super) fn run(
    settings: &Arc<EngineSettings>,
    queue: &Arc<SendQueue>,
    opened: &Opened,
) -> Result<(), Unavailable> {
    let failed = |error: FoxgloveError| {
        let (address, error) = (settings.listen, chain(&error));
        format!("cannot serve Foxglove on {address} (--listen chooses another address): {error}")
    };
    let context = Context::new();
    // Nodes that publish on the same topic share a channel, as in ROS.
    let mut channels = Vec::new();
    for topic in queue.topics.iter() {
        let (message, node) = (&topic.message, settings.nodes.get(topic.node));
        let schema = Schema::new(message.name(), "ros2msg", message.definition().as_bytes());
        let mut channel = ChannelBuilder::new(&topic.name).message_encoding("cdr").schema(schema);
        if let Some(node) = node.filter(|_| *message == MessageType::LASER_SCAN) {
            channel = channel.add_metadata("node", &node.full_name());
        }
        channels.push(channel.context(&context).build_raw().map_err(failed)?);
    }
    // The SDK joins host and port with a colon.
    let ip = settings.listen.ip();
    let host = if ip.is_ipv6() { format!("[{ip}]") } else { ip.to_string() };
    let server = WebSocketServer::new()
        .name(concat!("urg ", env!("CARGO_PKG_VERSION")))
        .context(&context)
        .message_backlog_size((settings.depth * settings.nodes.len()).max(MIN_BACKLOG))
        .bind(host, settings.listen.port())
        .start_blocking()
        .map_err(failed)?;
    let address = SocketAddr::new(ip, server.port());
    notice(format_args!("Foxglove and Lichtblick can connect to ws://{address}"));
    // An error means that the program ends.
    let _ = opened.send(Ok(Box::new(Foxglove(address))));
    while let Some(message) = queue.pop() {
        if let Some(channel) = channels.get(message.topic) {
            channel.log(&message.payload);
            message.counts.lock().add_published();
        }
    }
    // Closes all connections, without waiting: a client that never starts the WebSocket
    // handshake would block the exit.
    drop(server.stop());
    Ok(())
}

/// Address of the server.
struct Foxglove(SocketAddr);

impl Engine for Foxglove {
    fn check(&mut self) -> Result<Option<String>, Reopen> {
        // The SDK silently stops listening when the system cannot accept a connection, for
        // example because too many files are open. Starting it again closes them.
        let why = match TcpListener::bind(self.0) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => return Ok(None),
            Err(error) => format!("the server for Foxglove has failed: {error}"),
            Ok(_) => "the server for Foxglove no longer listens".to_owned(),
        };
        Err(Reopen::Dead(why))
    }
}
