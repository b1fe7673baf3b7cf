//! PORT arguments, and the sensors behind them. `name` parses PORT, `named` parses
//! `NAME=PORT@X,Y,YAW`, and `open` opens the sensor.

pub(crate) mod name;
pub(crate) mod named;
pub(crate) mod open;
