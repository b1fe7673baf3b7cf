//! Stand-ins for the commands of features that this build lacks. They take any
//! arguments, and fail with the name of the feature.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Defines the module of a command that needs a feature.
macro_rules! stand_in {
    ($module:ident, $Command:ident, $feature:literal) => {
        pub(crate) mod $module {
            use super::*;

            /// Not in this build
            #[derive(Debug, clap::Args)]
            #[command(hide = true, disable_help_flag = true)]
            pub(crate) struct $Command {
                #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
                _arguments: Vec<OsString>,
            }

            impl $Command {
                pub(crate) async fn run(self, _: &Interrupt) -> Result<(), Failure> {
                    Err(Failure::Usage(
                        concat!(
                            "`urg ",
                            stringify!($module),
                            "` needs an urg that was built with the \
                             feature `",
                            $feature,
                            "`: `cargo install tokio-scip --features \
                             cli,",
                            $feature,
                            "`"
                        )
                        .to_owned(),
                    ))
                }
            }
        }
    };
}

#[cfg(not(any(feature = "ros2", feature = "zenoh")))]
stand_in!(publish, Publish, "ros2");
#[cfg(not(feature = "mcap"))]
stand_in!(record, Record, "mcap");
#[cfg(not(feature = "mcap"))]
stand_in!(repair, Repair, "mcap");
#[cfg(not(feature = "web"))]
stand_in!(serve, Serve, "web");
