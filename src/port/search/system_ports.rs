//! [`SystemPorts`]: the serial ports of this machine that a URG can be on.

use super::super::list;
use super::super::serial::{SerialOpener, SerialPort};
use super::Ports;
use crate::Error;

/// Serial ports of this machine.
#[derive(Debug, Default)]
pub(in crate::port) struct SystemPorts {
    /// Ports that were opened, each with an opener of its own, so that a hanging one blocks no other.
    opened: Vec<(String, SerialOpener)>,
}

impl Ports for SystemPorts {
    type Port = SerialPort;

    async fn candidates(&mut self) -> Result<Vec<String>, Error> {
        let ports = list::list().await?;
        let paths = ports.into_iter().filter(|port| port.likely_sensor).map(|port| port.path);
        Ok(paths.filter(|path| !self.hangs(path)).collect())
    }

    async fn open(&mut self, path: &str) -> Result<SerialPort, Error> {
        let opener = SerialOpener::default();
        self.opened.push((path.to_owned(), opener.clone()));
        opener.open(path).await
    }
}

impl SystemPorts {
    /// Returns true while a call that opens or closes the port hangs in the system.
    fn hangs(&mut self, path: &str) -> bool {
        self.opened.retain(|(_, opener)| opener.is_busy());
        self.opened.iter().any(|(busy, _)| busy == path)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::ErrorKind;

    #[tokio::test]
    async fn o25_a_hanging_port_blocks_no_other() {
        let mut ports = SystemPorts::default();
        let opener = SerialOpener::default();
        let hang = opener.lock.lock().await;
        ports.opened.push(("/dev/hung".to_owned(), opener.clone()));
        assert!(ports.hangs("/dev/hung") && !ports.hangs("/dev/lost"));
        let error = ports.open("/dev/lost").await.map(drop).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::NoSuchPort { .. }), "{error}");
        drop(hang);
        assert!(!ports.hangs("/dev/hung"));
    }
}
