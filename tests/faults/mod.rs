//! Every row of the list of faults ([`list.txt`](list.txt)): what the driver
//! makes of it, on an emulated sensor that has the fault. Tests are named after
//! their rows; `coverage` fails where a row has none.

mod bytes;
mod coverage;
mod device;
mod hostile;
mod rig;
mod system;
mod tasks;
#[cfg(all(target_os = "linux", feature = "serial"))]
mod terminal;
mod timing;
mod wire;
