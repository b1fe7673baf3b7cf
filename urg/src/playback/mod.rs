//! Playback of a recording for human viewers: pause, step, seek, speed and loop.
//!
//! Commands that need every scan, such as `stream` and `record`, replay the sensor instead (`recording::recorded`).

mod command;
mod deck;
mod player;
mod settings;
mod window;

pub(crate) use self::command::PlaybackCommand;
pub(crate) use self::deck::PlaybackStatus;
pub(crate) use self::player::{Player, Shown};
pub(crate) use self::settings::PlaybackArgs;
pub(crate) use self::window::seen_through;
