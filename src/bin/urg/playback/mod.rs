//! The playback of a recording for people who look: pause, step, seek, speed and
//! loop. `deck` computes which scan is shown when, without a clock or a file;
//! `player` runs it, and `command` is what a user asks of it; `window` shows a scan
//! in another window than the recorded one, and `settings` are the options.
//!
//! Commands that need every scan, as `stream` and `record` do, replay the sensor
//! instead (`recording::recorded`).

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
