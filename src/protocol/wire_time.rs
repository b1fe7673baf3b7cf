//! [`Window::wire_time`]: how long a scan occupies a line.

use std::time::Duration;

use super::scip2::{Command, Data, Label, Request};
use super::{BaudRate, Protocol, Window};

impl Window {
    /// Time that one poll of this window occupies a line at this baud rate: command and reply, without
    /// intensities, but not the time that the sensor takes to answer.
    pub fn wire_time(&self, baud_rate: BaudRate, protocol: Protocol) -> Duration {
        let bytes = match protocol {
            Protocol::Scip1 => self.exchange_len(),
            Protocol::Scip2 => {
                let command = Command::Latest { data: Data::Distances, window: *self };
                let request = Request::new(command, Label::numbered(0));
                request.bytes().len() + 1 + request.reply_len().unwrap_or_default()
            }
        };
        baud_rate.wire_time(bytes)
    }
}
