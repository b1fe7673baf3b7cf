//! SCIP 2: bytes written by hand from the protocol text and from captures of real sensors, and
//! replies parsed by the driver.

mod commands;
mod driver;
mod faults;
mod histories;
mod scripts;
mod states;
mod streams;

use urg_emulator::{Emulator, EmulatorBuilder, Fixed, Mode, Model, Pace};

const MODELS: [Model; 4] = [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx];

/// Returns a sensor in SCIP 2 that answers at once and always measures 1,234 mm.
fn sensor(model: Model) -> EmulatorBuilder {
    super::limit::limit();
    let builder = Emulator::builder().model(model).mode(Mode::Scip2).serial_number("H0000001");
    builder.pace(Pace::AtOnce).world(Fixed::filled(1234))
}
