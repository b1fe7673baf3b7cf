//! The programs in `examples/`, asked for what they promise: as a user runs them, and on the
//! paused clock where faults and hours cost little.

mod example;
mod programs;
mod promises;
mod run;
mod tuio;
mod wall;
mod zones;
