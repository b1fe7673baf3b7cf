//! The hint for a command line without PORT: the sensors that are plugged in.

use tokio_scip::port::{self, PortInfo};

use crate::failure::Failure;

/// Returns the failure, with the ports of this machine in its hint.
pub(crate) async fn failure() -> Failure {
    Failure::Usage(hint(&port::list().await.unwrap_or_default()))
}

fn hint(ports: &[PortInfo]) -> String {
    let mut likely = ports.iter().filter(|port| port.is_likely_sensor());
    let example = |port: &str| {
        let mut words: Vec<_> = std::env::args().skip(1).collect();
        words.insert(words.len().min(1), port.to_owned());
        format!("urg {}", words.join(" "))
    };
    match (likely.next(), likely.next()) {
        (Some(only), None) => {
            format!(
                "which PORT? The only likely sensor here is on {0}: `{1}`",
                only.path,
                example(&only.path)
            )
        }
        (Some(one), Some(other)) => format!(
            "which PORT? There are likely sensors on {}, {} and maybe more, see `urg list`",
            one.path, other.path
        ),
        _ if ports.is_empty() => format!(
            "which PORT? This machine has no serial port: plug the sensor in, or try `{}`",
            example("emulated")
        ),
        _ => format!(
            "which PORT? No serial port here is a likely sensor: `urg list` shows them, \
             and `{}` needs none",
            example("emulated")
        ),
    }
}
