//! Commands that this build leaves out: each accepts any arguments, and names its features.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

macro_rules! absent {
    ($command:ident, $about:literal, $advice:literal) => {
        #[doc = $about]
        #[derive(Debug, clap::Args)]
        #[command(disable_help_flag = true)]
        pub(crate) struct $command {
            #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
            _arguments: Vec<OsString>,
        }

        impl $command {
            pub(crate) async fn run(self, _: &Interrupt) -> Result<(), Failure> {
                Err(Failure::Usage($advice.to_owned()))
            }
        }
    };
}

#[cfg(not(any(feature = "dds", feature = "zenoh", feature = "foxglove")))]
absent!(
    Publish,
    "Publish to ROS 2: not in this build, add `--features dds`",
    "`urg publish` is not in this build: build urg with the feature `dds`, `zenoh` or `foxglove` (`cargo install --path urg --features dds`)"
);
#[cfg(not(feature = "serve"))]
absent!(
    Serve,
    "Serve a live page: not in this build, add `--features serve`",
    "`urg serve` is not in this build: build urg with the feature `serve` (`cargo install --path urg` has it)"
);
#[cfg(not(feature = "view"))]
absent!(
    View,
    "Show a live radar: not in this build, add `--features view`",
    "`urg view` is not in this build: build urg with the feature `view` (`cargo install --path urg` has it)"
);
