//! A sensor that answers at once, from memory, without allocating, so that tests and
//! benchmarks measure the driver alone.

#![allow(dead_code, reason = "each test and benchmark uses a part of it")]

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

const VERSION: &[u8] = b"VEND:Hokuyo Automatic Co.,Ltd.\nPROD:SOKUIKI Sensor URG-04LX\nFIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])\nPROT:00003,(SCIP 1.0)\nSERI:H0713090\n";

/// A full line of data: 32 points at various distances.
const LINE: &[u8; 65] = b"0G0H0I0J1K2L3M4N5O6P7Q8R9S:T;U<V=W>X?Y@ZA[B\\C]D^E_F`GaHbIcJdKeLf\n";

/// Appends a sensor's reply to `command`. `V`, and `G` without clusters, succeed.
pub(crate) fn reply(command: &[u8], out: &mut Vec<u8>) {
    out.extend_from_slice(command);
    out.extend_from_slice(b"\n0\n");
    match command {
        b"V" => out.extend_from_slice(VERSION),
        [b'G', digits @ ..] if digits.len() == 8 => {
            let step = |digits: &[u8]| digits.iter().fold(0, |n, d| n * 10 + usize::from(d - b'0'));
            let mut left = 2 * (step(&digits[3..6]) + 1 - step(&digits[..3]));
            while left > 0 {
                let line = left.min(64);
                out.extend_from_slice(&LINE[..line]);
                out.push(b'\n');
                left -= line;
            }
        }
        _ => {}
    }
    out.push(b'\n');
}

/// Stream to such a sensor.
#[derive(Debug, Default)]
pub(crate) struct InstantSensor {
    line: Vec<u8>,
    reply: Vec<u8>,
    taken: usize,
    reader: Option<Waker>,
    is_silent: bool,
}

impl InstantSensor {
    pub(crate) fn new() -> Self {
        Self { line: Vec::with_capacity(64), reply: Vec::with_capacity(2048), ..Self::default() }
    }

    /// Does not wake its reader when a reply is ready.
    pub(crate) fn without_wakeups() -> Self {
        Self { is_silent: true, ..Self::new() }
    }
}

impl AsyncRead for InstantSensor {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = &mut *self;
        let ready = &this.reply[this.taken..];
        if ready.is_empty() {
            match &mut this.reader {
                Some(reader) => reader.clone_from(cx.waker()),
                None => this.reader = Some(cx.waker().clone()),
            }
            return Poll::Pending;
        }
        let count = ready.len().min(buffer.remaining());
        buffer.put_slice(&ready[..count]);
        this.taken += count;
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for InstantSensor {
    fn poll_write(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        for &byte in bytes {
            match byte {
                b'\n' if this.line.is_empty() => {}
                b'\n' => {
                    if this.taken == this.reply.len() {
                        this.reply.clear();
                        this.taken = 0;
                    }
                    reply(&this.line, &mut this.reply);
                    this.line.clear();
                }
                _ => this.line.push(byte),
            }
        }
        if let Some(reader) = this.reader.take_if(|_| !this.is_silent) {
            reader.wake();
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
