//! Tests that NULs are no part of a reply.

use tokio::io::AsyncWriteExt;
use tokio::time::sleep;

use super::*;
use crate::port::StreamPort;

const LIMITS: Limits = Limits { frame: 4096, frames: 64, bytes: 64 * 1024 };
const ANY: Expected = Expected { reply: None, limits: &LIMITS };

#[tokio::test(start_paused = true)]
async fn a_nul_before_or_behind_a_reply_begins_none() {
    let (near, mut far) = tokio::io::duplex(64);
    let mut transport = Transport::new(Box::new(StreamPort::new(near)), &LIMITS, true);
    let begin = Instant::now();
    let send = async {
        for piece in [&b"\0\0"[..], b"\0MD\n", b"00P\n\n\0", b"MD\n99b\n\n"] {
            sleep(Duration::from_millis(80)).await;
            far.write_all(piece).await.unwrap();
        }
    };
    let receive = async {
        let times = transport.ask(b"MD", &ANY, Duration::from_secs(1)).await.unwrap().times;
        assert_eq!(times.began - begin, Duration::from_millis(160));
        assert_eq!(times.received - begin, Duration::from_millis(240));
        transport.expect_unasked(&LIMITS, Duration::from_secs(1));
        let times = std::future::poll_fn(|cx| {
            transport.poll_unasked_frame(cx).map(|received| received.unwrap().times)
        });
        assert_eq!(times.await.began - begin, Duration::from_millis(320));
    };
    tokio::join!(send, receive);
}
