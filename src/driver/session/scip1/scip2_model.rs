//! Asks a sensor that has answered in SCIP 2 for its model, for the error message. Some sensors
//! of SCIP 1.1 lock up on such a command, so no other sensor gets it.

use super::super::super::transport::Expected;
use super::{LIMITS, Session};
use crate::ErrorKind;
use crate::codec::FoundFrame;
use crate::protocol::{Command, Text};

/// Longest model name that is reported.
const EXCERPT: usize = 64;

impl Session {
    /// Adds the model to the error of a sensor that speaks SCIP 2, if it tells its model in time.
    pub(super) async fn name_model(&mut self, error: ErrorKind) -> ErrorKind {
        match error {
            ErrorKind::WrongProtocol { status, .. } => {
                ErrorKind::WrongProtocol { status, model: self.scip2_model().await }
            }
            error => error,
        }
    }

    async fn scip2_model(&mut self) -> Option<Text> {
        let within = self.time_limit(&Command::Version, self.latency(&Command::Version));
        let expected = Expected { reply: None, limits: &LIMITS };
        self.transport.send(b"VV", &expected, within).await.ok()?;
        loop {
            let received = self.transport.next_frame().await.ok()?;
            if let FoundFrame::Reply(frame) = received.frame()
                && let Some(model) = model(frame)
            {
                return Some(model);
            }
        }
    }
}

/// Finds the model in a reply to `VV`, or the product's name: lines such as `MODL:UST-10LX;`
/// and a checksum.
fn model(frame: &[u8]) -> Option<Text> {
    let lines = frame.strip_prefix(b"VV\n00P\n")?;
    let value = |name: &[u8]| {
        lines.split(|byte| *byte == b'\n').find_map(|line| {
            let [text @ .., b';', checksum] = line else { return None };
            let sum = text.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
            text.strip_prefix(name).filter(|_| *checksum == (sum & 0x3f) + 0x30)
        })
    };
    value(b"MODL:").or_else(|| value(b"PROD:")).map(|model| Text::excerpt(model, EXCERPT))
}
