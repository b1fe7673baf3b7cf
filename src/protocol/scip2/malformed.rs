//! [`ReplyError`]: why a frame is not the reply to its request.

use crate::protocol::Text;
pub use crate::protocol::fault::MalformedError;

/// Number of bytes of a frame to show in an error message.
const EXCERPT: usize = 32;

/// Why a frame is not the reply to a request.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// It does not begin with the request: it answers another one, or its echo is damaged.
    #[error("expected the echo of the request, found \"{0}\"")]
    Foreign(Text),
    /// It begins with the request, but the rest is malformed.
    #[error(transparent)]
    Malformed(#[from] MalformedError),
    /// It has a status of one character, as in SCIP 1.1.
    #[error("expected SCIP 2, found the status \"{0}\" of SCIP 1.1: send SCIP2.0 to a URG-04LX")]
    Scip1(Text),
    /// It answers a command for several echoes a step, which another program sent.
    #[error("expected one echo a step, found \"{0}\", which asks for several: stop it with QT")]
    MultiEcho(Text),
    /// It begins with STX, as the frames of UAM safety scanners do.
    #[error("expected SCIP 2, found a frame of the UAM safety scanners' own protocol: send MD")]
    Uam,
}

/// First bytes in quotes, safe to show.
pub(super) fn quoted(bytes: &[u8]) -> String {
    format!("\"{}\"", Text::excerpt(bytes, EXCERPT))
}

/// Error for a frame that does not begin with its request.
pub(super) fn foreign(frame: &[u8]) -> ReplyError {
    let echo = frame.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let found = Text::excerpt(echo, EXCERPT);
    match frame {
        [0x02, ..] => ReplyError::Uam,
        [b'H' | b'N', b'D' | b'E', b'0'..=b'9', ..] => ReplyError::MultiEcho(found),
        _ => ReplyError::Foreign(found),
    }
}
