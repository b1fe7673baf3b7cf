//! The protocol values, held against the text C-42-3320-A and against what
//! real sensors send. The bytes here are written by hand from the text, or
//! built by [`encoder`], which shares nothing with the crate.

mod arbitrary;
mod damage;
mod encoder;
mod fence;
mod replies;
mod values;
mod version;
mod windows;
