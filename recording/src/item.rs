//! [`WriteItem`]: what a recorder writes, on its way into the file.

use std::collections::BTreeMap;

use tokio::sync::oneshot;

use super::writer::Times;
use tokio_scip::Scan;
use tokio_scip::protocol::Protocol;

/// Bytes that a waiting item takes besides its content.
const OVERHEAD_BYTES: usize = 128;

#[derive(Debug)]
pub(super) enum WriteItem {
    Scan(Scan),
    Reply {
        request: String,
        bytes: Box<[u8]>,
        times: Times,
    },
    Event {
        json: String,
        times: Times,
    },
    Metadata(BTreeMap<String, String>),
    /// Ends the file, and confirms that it was written.
    Finish(oneshot::Sender<()>),
}

impl WriteItem {
    pub(super) fn weight(&self) -> usize {
        OVERHEAD_BYTES
            + match self {
                Self::Scan(scan) => match scan.geometry().protocol() {
                    Protocol::Scip1 => scan.len() * size_of::<u16>(),
                    Protocol::Scip2 => {
                        let intensities = scan.intensities().unwrap_or_default().len();
                        (scan.len() + intensities) * size_of::<u32>()
                    }
                },
                Self::Reply { bytes, .. } => bytes.len(),
                Self::Event { json, .. } => json.len(),
                Self::Metadata(_) | Self::Finish(_) => 0,
            }
    }
}
