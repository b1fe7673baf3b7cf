//! The codec in the form of tokio-util, for `Framed`. The driver does not use it.

use std::io;

use bytes::BytesMut;
use tokio_util::codec::{Decoder, Encoder};

use super::{Frame, ScipCodec, TERMINATOR};
use crate::protocol::Command;

impl Decoder for ScipCodec {
    type Item = Frame;
    type Error = io::Error;

    fn decode(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        Ok(self.find(buffer).map(|frame| match frame {
            Frame::Reply(length) => {
                let mut reply = buffer.split_to(length + TERMINATOR);
                reply.truncate(length);
                Frame::Reply(reply)
            }
            Frame::Overlong { bytes } => Frame::Overlong { bytes },
        }))
    }

    fn decode_eof(&mut self, buffer: &mut BytesMut) -> io::Result<Option<Frame>> {
        let frame = self.decode(buffer)?;
        if frame.is_none() {
            // The rest of a reply cannot come after the end of the stream.
            buffer.clear();
            self.reset();
        }
        Ok(frame)
    }
}

impl Encoder<&Command> for ScipCodec {
    type Error = io::Error;

    fn encode(&mut self, command: &Command, buffer: &mut BytesMut) -> io::Result<()> {
        self.put_command(command, buffer);
        Ok(())
    }
}
