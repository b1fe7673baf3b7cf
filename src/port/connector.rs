//! [`EndpointConnector`]: opens the port that an [`Endpoint`] names, again after each loss of the link.

use std::fmt;

use super::{Connect, ConnectHints, Endpoint, Port};
#[cfg(feature = "tcp")]
use super::{StreamPort, endpoint::line_baud_rate, lookup::Lookup, tcp};
#[cfg(feature = "serial")]
use super::{
    search::{Search, SystemPorts},
    serial::SerialOpener,
};
#[cfg(feature = "tcp")]
use crate::BaudRate;
use crate::Error;
#[cfg(not(all(feature = "serial", feature = "tcp")))]
use crate::ErrorKind;

/// [`Connect`] for the port that an [`Endpoint`] names.
#[derive(Debug)]
struct EndpointConnector {
    route: Route,
    /// Text of the endpoint, for error messages.
    name: String,
}

#[derive(Debug)]
enum Route {
    #[cfg(feature = "serial")]
    Serial { path: String, opener: SerialOpener },
    #[cfg(feature = "serial")]
    SerialNumber(Search<SystemPorts>),
    #[cfg(feature = "tcp")]
    Tcp { host: String, port: u16, baud_rate: Option<BaudRate>, lookup: Lookup },
    /// This build cannot open the endpoint, for this reason.
    #[cfg(not(all(feature = "serial", feature = "tcp")))]
    Missing(&'static str),
}

#[cfg(not(feature = "serial"))]
const NO_SERIAL: &str =
    "this program was built without the feature `serial` of tokio-scip, which serial ports need";
#[cfg(not(feature = "tcp"))]
const NO_TCP: &str =
    "this program was built without the feature `tcp` of tokio-scip, which TCP needs";

impl Endpoint {
    /// Converts the endpoint into a connector, which reopens its port after each loss of the link.
    ///
    /// # Serial numbers
    ///
    /// For [`Endpoint::SerialNumber`], each [`connect`](Connect::connect) opens the next USB
    /// port of a Hokuyo sensor. The driver checks whether it has the right sensor. The search skips
    /// ports that cannot be opened within 2 s. It retries them and busy ones for 2 s, and opens each
    /// port that appears in that time. After the last candidate the error is
    /// [`NoSuchSensor`](crate::ErrorKind::NoSuchSensor), or
    /// [`PermissionDenied`](crate::ErrorKind::PermissionDenied) if you may not open one of the
    /// ports. The next call lists the ports again.
    pub fn into_connector(self) -> impl Connect<Port = Box<dyn Port>> + fmt::Debug {
        let name = self.to_string();
        let route = match self {
            #[cfg(feature = "serial")]
            Self::Serial(path) => Route::Serial { path, opener: SerialOpener::default() },
            #[cfg(feature = "serial")]
            Self::SerialNumber(number) => {
                Route::SerialNumber(Search::new(number, SystemPorts::default()))
            }
            #[cfg(not(feature = "serial"))]
            Self::Serial(_) | Self::SerialNumber(_) => Route::Missing(NO_SERIAL),
            #[cfg(feature = "tcp")]
            Self::Tcp { host, port, baud_rate } => {
                let baud_rate = line_baud_rate(port, baud_rate);
                Route::Tcp { host, port, baud_rate, lookup: Lookup::default() }
            }
            #[cfg(not(feature = "tcp"))]
            Self::Tcp { .. } => Route::Missing(NO_TCP),
        };
        EndpointConnector { route, name }
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
            #[cfg(feature = "tcp")]
            Route::Tcp { host, port, baud_rate, lookup } => {
                let opened = tcp::connect(lookup, host, *port).await;
                let stream = opened.map_err(|source| Error::open(self.name.as_str(), source))?;
                let baud_rate = *baud_rate;
                Ok(Box::new(StreamPort { stream, baud_rate, can_die_silently: true }))
            }
            #[cfg(not(all(feature = "serial", feature = "tcp")))]
            Route::Missing(reason) => {
                Err(ErrorKind::InvalidEndpoint { text: self.name.clone(), reason }.into())
            }
        }
    }

    fn name(&self) -> Option<&str> {
        Some(&self.name)
    }

    fn hints(&mut self) -> Option<&mut dyn ConnectHints> {
        match &mut self.route {
            #[cfg(feature = "serial")]
            Route::SerialNumber(search) => Some(search),
            _ => None,
        }
    }
}
