//! The link to the sensor in words: the reason why no scan can come now. Notices,
//! the radar and the web page use the same words.

use tokio_scip::State;

use crate::failure::chain;

/// Returns the reason why no scan can come in this state; `None` while the
/// sensor is connected.
pub(crate) fn trouble(state: &State) -> Option<String> {
    Some(match state {
        State::Connected { .. } => return None,
        State::Connecting { error: Some(error) } => {
            format!("waiting for a sensor: {}", chain(error))
        }
        State::Connecting { error: None } => "looking for the sensor".to_owned(),
        State::Recovering => "the sensor is silent: looking for it at every baud rate".to_owned(),
        State::Disconnected { error, .. } | State::Closed { error: Some(error) } => chain(error),
        State::Closed { error: None } => "the driver is closed".to_owned(),
        _ => "the driver is in a state that this program does not know".to_owned(),
    })
}
