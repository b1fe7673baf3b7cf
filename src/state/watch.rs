//! [`StateWatch`]: waits for a state.

use std::fmt;
use std::sync::Arc;

use tokio::sync::watch;

use super::State;
use crate::{Error, ErrorKind};

/// Watch of a sensor's [`State`], returned by [`Sensor::watch_state`](crate::Sensor::watch_state).
///
/// All reads return copies, so you can hold them as long as you like. A watch begins with
/// the state at the time of its creation. It keeps neither the driver nor the port alive.
///
/// All futures are cancel-safe, and all end when the driver does: [`State::Closed`] is final.
///
/// ```
/// # use urg_emulator::Emulator;
/// use tokio_scip::{Sensor, State};
///
/// # #[tokio::main(flavor = "current_thread", start_paused = true)]
/// # async fn main() -> Result<(), tokio_scip::Error> {
/// # let emulator = Emulator::default();
/// # let sensor = Sensor::builder().connect(emulator.clone()).await?;
/// let mut state = sensor.watch_state();
/// state.connected().await?;
/// # emulator.unplug();
/// while let Some(now) = state.changed().await {
///     match now {
///         State::Connected { .. } => println!("the sensor answers"),
///         State::Closed { error: Some(error) } => println!("no sensor any more: {error}"),
///         _ => println!("no scans at the moment"),
///     }
/// #   sensor.close().await;
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct StateWatch {
    pub(super) receiver: watch::Receiver<State>,
    /// The name of the sensor, for errors.
    pub(super) name: Option<Arc<str>>,
}

impl StateWatch {
    /// Current state.
    pub fn get(&self) -> State {
        self.receiver.borrow().clone()
    }

    /// Waits until the state has changed, and returns the new one, or `None` after
    /// [`State::Closed`]. After several changes you get only the latest.
    pub async fn changed(&mut self) -> Option<State> {
        let is_closed = matches!(*self.receiver.borrow(), State::Closed { .. });
        if is_closed && !self.receiver.has_changed().unwrap_or_default() {
            return None;
        }
        // Fails only if no sender is left to change it.
        self.receiver.changed().await.ok()?;
        Some(self.receiver.borrow_and_update().clone())
    }

    /// Waits until `is_wanted` returns true for the state, and returns it.
    ///
    /// # Errors
    ///
    /// The cause, or [`ErrorKind::Closed`], if the driver has ended in another state.
    pub async fn wait_for(
        &mut self,
        mut is_wanted: impl FnMut(&State) -> bool,
    ) -> Result<State, Error> {
        let mut wanted = false;
        let ends = |state: &State| {
            wanted = is_wanted(state);
            wanted || matches!(state, State::Closed { .. })
        };
        // The driver may also have been dropped without a final state.
        let state = self.receiver.wait_for(ends).await.map(|state| state.clone());
        match state {
            Ok(state) if wanted => Ok(state),
            Ok(State::Closed { error: Some(error) }) => Err(error),
            _ => Err(Error::new(ErrorKind::Closed, self.name.as_ref())),
        }
    }

    /// Waits until the sensor answers. Returns at once if it does.
    ///
    /// # Errors
    ///
    /// The cause, or [`ErrorKind::Closed`], if the driver has ended.
    pub async fn connected(&mut self) -> Result<(), Error> {
        self.wait_for(|state| matches!(state, State::Connected { .. })).await.map(drop)
    }
}

impl fmt::Debug for StateWatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("StateWatch").field(&self.get()).finish()
    }
}
