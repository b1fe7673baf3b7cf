//! [`EndpointConnector`]: opens what an [`Endpoint`] names, time after time.

use super::{Connect, Endpoint, Port, TcpPort};
#[cfg(feature = "serial")]
use super::{
    search::{Search, SystemPorts},
    serial::Opener,
};
use crate::{BaudRate, Error};

/// Opens the port that an [`Endpoint`] names; made by
/// [`Endpoint::into_connector`].
///
/// # Serial numbers
///
/// For [`Endpoint::SerialNumber`] each [`connect`](Connect::connect) opens the
/// next port that has the sensors' USB id; whether the right sensor is there
/// is for the caller to find out, and [`has_more`](Connect::has_more) says that
/// another call goes on with the pass. Ports that do not open are passed over,
/// busy ones after a second try half a second later. When none is left the
/// error is [`Error::NoSuchSensor`], or [`Error::PermissionDenied`] if a port
/// was passed over for that; the next call lists the ports anew.
#[derive(Debug)]
pub struct EndpointConnector {
    route: Route,
}

#[derive(Debug)]
enum Route {
    #[cfg(feature = "serial")]
    Serial {
        path: String,
        opener: Opener,
    },
    #[cfg(feature = "serial")]
    SerialNumber(Search<SystemPorts>),
    Tcp {
        host: String,
        port: u16,
        baud_rate: BaudRate,
    },
}

impl EndpointConnector {
    pub(super) fn new(endpoint: Endpoint) -> Self {
        let route = match endpoint {
            #[cfg(feature = "serial")]
            Endpoint::Serial(path) => Route::Serial { path, opener: Opener::default() },
            #[cfg(feature = "serial")]
            Endpoint::SerialNumber(number) => {
                Route::SerialNumber(Search::new(number, SystemPorts::default()))
            }
            Endpoint::Tcp { host, port, baud_rate } => Route::Tcp { host, port, baud_rate },
        };
        Self { route }
    }
}

impl Connect for EndpointConnector {
    type Port = Box<dyn Port>;

    async fn connect(&mut self) -> Result<Box<dyn Port>, Error> {
        match &mut self.route {
            #[cfg(feature = "serial")]
            Route::Serial { path, opener } => Ok(Box::new(opener.open(path).await?)),
            #[cfg(feature = "serial")]
            Route::SerialNumber(search) => Ok(Box::new(search.next_port().await?)),
            Route::Tcp { host, port, baud_rate } => {
                Ok(Box::new(TcpPort::connect(host, *port, *baud_rate).await?))
            }
        }
    }

    fn has_more(&self) -> bool {
        match &self.route {
            #[cfg(feature = "serial")]
            Route::SerialNumber(search) => search.has_more(),
            _ => false,
        }
    }

    fn found(&mut self) {
        match &mut self.route {
            #[cfg(feature = "serial")]
            Route::SerialNumber(search) => search.start_over(),
            _ => {}
        }
    }

    fn expected_serial_number(&self) -> Option<&str> {
        match &self.route {
            #[cfg(feature = "serial")]
            Route::SerialNumber(search) => Some(search.serial_number()),
            _ => None,
        }
    }
}
