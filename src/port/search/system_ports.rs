//! [`SystemPorts`]: the serial ports of this machine that a URG can be on.

use super::super::list;
use super::super::serial::{SerialOpener, SerialPort};
use super::Ports;
use crate::{Error, ErrorKind};

/// Serial ports of this machine.
#[derive(Debug, Default)]
pub(in crate::port) struct SystemPorts {
    /// Port that was opened last, and its opener.
    latest: Option<(String, SerialOpener)>,
    /// Earlier ports whose opening or closing hangs in the system. Each port has its own opener, so
    /// that a hanging one blocks no other.
    hanging: Vec<(String, SerialOpener)>,
}

impl Ports for SystemPorts {
    type Port = SerialPort;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        let ports = list::list().await?;
        Ok(ports.into_iter().filter(|port| port.likely_sensor).map(|port| port.path).collect())
    }

    async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        self.keep_latest();
        if self.hanging.iter().any(|(hanging, _)| hanging == path) {
            // One thread for it is enough.
            return Err(ErrorKind::Busy { port: path.to_owned() }.into());
        }
        let (_, opener) = self.latest.insert((path.to_owned(), SerialOpener::default()));
        opener.open(path).await
    }

    fn one_hangs_no_longer(&mut self) -> bool {
        self.keep_latest();
        let before = self.hanging.len();
        self.hanging.retain_mut(|(_, opener)| opener.is_busy());
        self.hanging.len() < before
    }
}

impl SystemPorts {
    /// Keeps the latest port if it is not closed by now.
    fn keep_latest(&mut self) {
        if let Some((path, mut opener)) = self.latest.take()
            && opener.is_busy()
        {
            self.hanging.push((path, opener));
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn o25_a_hanging_port_blocks_no_other() {
        let (hang, opener) = SerialOpener::hanging();
        let mut ports = SystemPorts {
            latest: Some(("/dev/gone".to_owned(), opener)),
            ..SystemPorts::default()
        };
        let mut open = async |path: &str| ports.open(path).await.map(drop).unwrap_err();
        for _ in 0..2 {
            let error = open("/dev/gone").await;
            assert!(
                matches!(error.kind(), ErrorKind::Busy { .. }),
                "one thread is enough: {error}"
            );
            let error = open("/dev/lost").await;
            assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error}");
        }
        assert!(!ports.one_hangs_no_longer());
        drop(hang);
        assert!(ports.one_hangs_no_longer());
        assert!(!ports.one_hangs_no_longer(), "told once");
        let error = ports.open("/dev/gone").await.map(drop).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error}");
    }
}
