//! Tests of the driver against each fault in [`list.txt`](list.txt), on an emulated
//! sensor that has the fault. A test's name begins with the ids of its rows; `coverage`
//! fails where a row has no test.

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
