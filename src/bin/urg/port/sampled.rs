//! A sample of what a port sends, so that an error about bytes that are no reply can
//! show them: text of another device is often recognised at a glance.

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::SystemTime;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_scip::{BaudRate, Error};
use tokio_scip::{Connect, Port};

/// So many bytes are kept for each baud rate.
const SAMPLE_BYTES: usize = 40;

/// The first bytes that came at each baud rate. Clones share them.
#[derive(Debug, Clone, Default)]
pub(crate) struct ByteSample(Arc<Mutex<BTreeMap<Option<BaudRate>, Vec<u8>>>>);

impl ByteSample {
    /// Returns the bytes as text: at the baud rate at which most of them are readable.
    /// At a wrong one they are noise.
    pub(crate) fn text(&self) -> Option<String> {
        let samples = self.samples();
        let readable = |bytes: &Vec<u8>| {
            let count = bytes.iter().filter(|byte| is_readable(**byte)).count();
            count * 1000 / bytes.len().max(1)
        };
        let best = samples.iter().filter(|(_, bytes)| !bytes.is_empty());
        let (baud_rate, bytes) = best.max_by_key(|(_, bytes)| readable(bytes))?;
        let text = format!("\"{}\"", bytes.escape_ascii());
        Some(match baud_rate {
            Some(baud_rate) => format!("{text} at {baud_rate} baud"),
            None => text,
        })
    }

    fn samples(&self) -> MutexGuard<'_, BTreeMap<Option<BaudRate>, Vec<u8>>> {
        // Nothing panics while it is held.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes bytes that came. Returns whether it has enough of this baud rate.
    fn take(&self, baud_rate: Option<BaudRate>, bytes: &[u8]) -> bool {
        let mut samples = self.samples();
        let sample = samples.entry(baud_rate).or_default();
        let room = SAMPLE_BYTES.saturating_sub(sample.len());
        sample.extend(bytes.iter().take(room));
        sample.len() >= SAMPLE_BYTES
    }
}

fn is_readable(byte: u8) -> bool {
    matches!(byte, b' '..=b'~' | b'\r' | b'\n')
}

/// Opens ports whose first bytes are sampled.
pub(crate) struct SampledConnect<C> {
    pub(crate) connect: C,
    pub(crate) sample: ByteSample,
}

// A method that is not passed on would change how the driver treats the port.
#[deny(clippy::missing_trait_methods)]
impl<C: Connect> Connect for SampledConnect<C> {
    type Port = SampledPort<C::Port>;

    async fn connect(&mut self) -> Result<Self::Port, Error> {
        let port = self.connect.connect().await?;
        Ok(SampledPort { port, sample: self.sample.clone(), is_enough: false })
    }

    fn name(&self) -> Option<&str> {
        self.connect.name()
    }

    fn has_more(&self) -> bool {
        self.connect.has_more()
    }

    fn found(&mut self) {
        self.connect.found();
    }

    fn expected_serial_number(&self) -> Option<&str> {
        self.connect.expected_serial_number()
    }
}

/// A port whose first bytes are sampled.
pub(crate) struct SampledPort<P> {
    port: P,
    sample: ByteSample,
    /// Set once nothing more is to be kept at this baud rate.
    is_enough: bool,
}

impl<P: Port> SampledPort<P> {
    fn take(&mut self, bytes: &[u8]) {
        if !self.is_enough {
            self.is_enough = self.sample.take(self.port.baud_rate(), bytes);
        }
    }
}

impl<P: Port> AsyncRead for SampledPort<P> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.port).poll_read(cx, buffer);
        self.take(buffer.filled().get(before..).unwrap_or_default());
        read
    }
}

impl<P: Port> AsyncWrite for SampledPort<P> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.port).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

#[deny(clippy::missing_trait_methods)]
impl<P: Port> Port for SampledPort<P> {
    fn baud_rate(&self) -> Option<BaudRate> {
        self.port.baud_rate()
    }

    fn set_baud_rate(&mut self, baud_rate: BaudRate) -> io::Result<()> {
        self.is_enough = false;
        self.port.set_baud_rate(baud_rate)
    }

    fn wall_clock(&self) -> SystemTime {
        self.port.wall_clock()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        let read = self.port.try_read(buffer);
        if let Some(Ok(count)) = read {
            self.take(buffer.get(..count).unwrap_or_default());
        }
        read
    }

    fn suspend_wakeups(&mut self) -> bool {
        self.port.suspend_wakeups()
    }

    fn can_die_silently(&self) -> bool {
        self.port.can_die_silently()
    }

    fn is_over(&self) -> bool {
        self.port.is_over()
    }

    fn discard_output(&mut self) {
        self.port.discard_output();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_and_the_serial_number_are_those_of_the_port() {
        let endpoint: tokio_scip::Endpoint = "serial:H0713090".parse().unwrap();
        let connect = endpoint.into_connector();
        let (name, number) = (connect.name().map(str::to_owned), connect.expected_serial_number());
        assert_eq!(number, Some("H0713090"));
        let sampled = SampledConnect { sample: ByteSample::default(), connect };
        assert_eq!(sampled.name(), name.as_deref());
        assert_eq!(sampled.expected_serial_number(), Some("H0713090"));
    }

    #[test]
    fn the_sample_is_of_the_baud_rate_at_which_it_is_readable() {
        let sample = ByteSample::default();
        assert_eq!(sample.text(), None);
        assert!(!sample.take(Some(BaudRate::B19200), b"\xff\x00\x80\x13A"));
        assert!(!sample.take(Some(BaudRate::B115200), b"$GPGGA,12"));
        assert!(!sample.take(Some(BaudRate::B115200), b"3519\r\n"));
        assert_eq!(sample.text().unwrap(), r#""$GPGGA,123519\r\n" at 115200 baud"#);
        let sample = ByteSample::default();
        assert!(sample.take(None, &[b'x'; 99]));
        assert_eq!(sample.text().unwrap(), format!("\"{}\"", "x".repeat(SAMPLE_BYTES)));
    }
}
