//! The `urg` program, run as a user runs it: in real time, and without sleeping. Each wait
//! is for a line that the program writes, or for its end.

mod check;
mod ends;
mod formats;
#[cfg(feature = "web")]
mod http;
mod packaging;
mod picture;
#[cfg(all(feature = "mcap", feature = "web"))]
mod playback;
mod program;
#[cfg(feature = "mcap")]
mod recorded;
#[cfg(feature = "mcap")]
mod repaired;
#[cfg(unix)]
mod screen;
mod served;
#[cfg(feature = "web")]
mod several;
#[cfg(feature = "web")]
mod slow_clients;
mod usage;
#[cfg(feature = "web")]
mod web;
