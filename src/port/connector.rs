//! [`EndpointConnector`]: opens the port that an [`Endpoint`] names, again after each
//! loss of the link.

use super::{Connect, Endpoint, Port, TcpPort};
#[cfg(feature = "serial")]
use super::{
    search::{Search, SystemPorts},
    serial::SerialOpener,
};
use crate::{BaudRate, Error};

/// A [`Connect`] for the port that an [`Endpoint`] names, made by
/// [`Endpoint::into_connector`].
///
/// # Serial numbers
///
/// For [`Endpoint::SerialNumber`] each [`connect`](Connect::connect) opens the
/// next port with the USB id of URG sensors. The caller checks whether the right
/// sensor is there; while [`has_more`](Connect::has_more) is true another call opens
/// the next candidate. A port that cannot be opened, or not within 2 s, is skipped; a
/// busy one is tried once more half a second later. After the last candidate the
/// error is [`Error::NoSuchSensor`], or [`Error::PermissionDenied`] if a port was
/// skipped for that; the next call lists the ports again.
#[derive(Debug)]
pub struct EndpointConnector {
    route: Route,
    /// The endpoint's text, for error messages.
    name: String,
}

#[derive(Debug)]
enum Route {
    #[cfg(feature = "serial")]
    Serial {
        path: String,
        opener: SerialOpener,
    },
    #[cfg(feature = "serial")]
    SerialNumber(Search<SystemPorts>),
    Tcp {
        host: String,
        port: u16,
        baud_rate: BaudRate,
    },
}

impl Endpoint {
    /// Converts the endpoint into a connector, which opens its port again after each
    /// loss of the link.
    pub fn into_connector(self) -> EndpointConnector {
        EndpointConnector::new(self)
    }
}

impl EndpointConnector {
    fn new(endpoint: Endpoint) -> Self {
        let name = endpoint.to_string();
        let route = match endpoint {
            #[cfg(feature = "serial")]
            Endpoint::Serial(path) => Route::Serial { path, opener: SerialOpener::default() },
            #[cfg(feature = "serial")]
            Endpoint::SerialNumber(number) => {
                Route::SerialNumber(Search::new(number, SystemPorts::default()))
            }
            Endpoint::Tcp { host, port, baud_rate } => Route::Tcp { host, port, baud_rate },
        };
        Self { route, name }
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

    fn name(&self) -> Option<&str> {
        Some(&self.name)
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
