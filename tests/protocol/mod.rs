//! The protocol's values, compared with the text C-42-3320-A and with replies of real
//! sensors. The bytes here are written by hand from the text, or made by [`encoder`],
//! which shares no code with the crate.

mod arbitrary;
mod codec;
mod damage;
mod encoder;
mod fence;
pub(crate) mod geometry;
mod replies;
mod scip2;
mod sums;
mod values;
mod version;
mod windows;
