//! Drops the bytes that are older than the next command.

use std::future::poll_fn;
use std::io;
use std::task::Poll;

use super::super::failure::LinkError;
use super::budget::{poll_read, try_read};
use super::{READ_BUFFER_BYTES, Transport};
use crate::port::Port;

/// Number of interrupted reads in a row after which the port counts as quiet.
const MAX_INTERRUPTED: usize = 16;

/// Length of one read when bytes are dropped.
const SCRATCH_BYTES: usize = 512;

impl Transport {
    /// Drops the bytes since the last reply, older than the next command. Returns their number.
    pub(crate) async fn discard_pending(&mut self) -> Result<u64, LinkError> {
        if let Some(outcome) = self.try_discard_pending() {
            return outcome;
        }
        // While this task yields, the runtime polls the system for new input.
        tokio::task::yield_now().await;
        let dropped = poll_fn(|cx| {
            Poll::Ready(self.drop_bytes(|port, mut bytes| {
                try_read(port, bytes).or_else(|| match poll_read(port, cx, &mut bytes) {
                    Poll::Ready(outcome) => Some(outcome),
                    Poll::Pending => Some(Err(io::ErrorKind::WouldBlock.into())),
                })
            }))
        });
        dropped.await.unwrap_or(Ok(0))
    }

    /// Does the same without waiting. Returns `None` if the port cannot be read so.
    pub(crate) fn try_discard_pending(&mut self) -> Option<Result<u64, LinkError>> {
        self.drop_bytes(try_read)
    }

    /// Drops the input, and the bytes that `read` returns until it would block. Repeats an
    /// interrupted read. Returns the number of bytes, or `None` as soon as `read` returns `None`.
    fn drop_bytes(
        &mut self,
        mut read: impl FnMut(&mut Box<dyn Port>, &mut [u8]) -> Option<io::Result<usize>>,
    ) -> Option<Result<u64, LinkError>> {
        let before = self.received - self.input.len() as u64;
        let mut scratch = [0; SCRATCH_BYTES];
        let mut interrupted = 0;
        loop {
            match read(&mut self.port, &mut scratch)? {
                Ok(0) => return Some(Err(self.lost(None))),
                Ok(read) => {
                    let fresh = scratch.get(..read).unwrap_or_default();
                    self.received += read as u64;
                    self.greeting.add(fresh);
                    if let Err(flood) = self.check_flood() {
                        return Some(Err(self.lost(Some(flood))));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                    interrupted += 1;
                    if interrupted == MAX_INTERRUPTED {
                        break;
                    }
                }
                Err(error) => return Some(Err(self.lost(Some(error)))),
            }
        }
        self.clear_input();
        // Without this, replies would use up the buffer and need two reads.
        self.input.reserve(READ_BUFFER_BYTES);
        Some(Ok(self.received - before))
    }

    pub(super) fn clear_input(&mut self) {
        self.input.clear();
        self.codec.reset();
        self.times = None;
    }
}
