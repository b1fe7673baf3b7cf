//! The emulated sensor against the protocol text: its replies, their times, and its
//! faults on demand. Expected bytes are written by hand.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod baud_rate;
mod commands;
mod faults;
mod handle;
mod independence;
#[path = "../../tests/common/limit.rs"]
mod limit;
mod lines;
mod motor;
mod replies;
mod scip2;
#[path = "../../tests/properties/script.rs"]
mod script;
mod served;
mod time;
mod worlds;

use std::time::Duration;

use proptest::prelude::*;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use urg_emulator::{Emulator, EmulatorBuilder, Fixed, Pace, RepeatedLaser};

/// Returns a sensor that answers at once and always measures 1,234 mm.
fn instant_sensor() -> EmulatorBuilder {
    limit::limit();
    // The status of a repeated `L` then shows the state that the laser is in.
    let builder = Emulator::builder().repeated_laser(RepeatedLaser::Status2);
    builder.pace(Pace::AtOnce).world(Fixed::filled(1234))
}

/// Sends `command` with a line feed, and returns the reply: all bytes within ten
/// seconds, up to the double line feed.
async fn ask(link: &mut (impl AsyncRead + AsyncWrite + Unpin), command: &str) -> String {
    link.write_all(command.as_bytes()).await.unwrap();
    link.write_all(b"\n").await.unwrap();
    listen(link).await
}

/// Returns the bytes that arrive within ten seconds, up to a double line feed.
async fn listen(link: &mut (impl AsyncRead + Unpin)) -> String {
    String::from_utf8(listen_bytes(link).await).unwrap()
}

async fn listen_bytes(link: &mut (impl AsyncRead + Unpin)) -> Vec<u8> {
    let mut reply = Vec::new();
    let read = async {
        while !reply.ends_with(b"\n\n") {
            match link.read_u8().await {
                Ok(byte) => reply.push(byte),
                Err(_) => break,
            }
        }
    };
    let _ = tokio::time::timeout(Duration::from_secs(10), read).await;
    reply
}

proptest! {
    #[test]
    fn every_line_is_answered_as_the_table_says(script in prop::collection::vec(any::<u8>(), 0..100)) {
        commands::every_line_is_answered_as_the_table_says(&script);
    }
}
