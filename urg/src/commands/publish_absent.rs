//! `urg publish` in a build without an engine: accepts any arguments, and names the features
//! you have to build with.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Publish to ROS 2: not in this build, add `--features dds`
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Publish {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _arguments: Vec<OsString>,
}

impl Publish {
    pub(crate) async fn run(self, _: &Interrupt) -> Result<(), Failure> {
        Err(Failure::Usage(
            "`urg publish` is not in this build: build urg with the feature `dds`, `zenoh` or `foxglove` (`cargo install --path urg --features dds`)"
                .to_owned(),
        ))
    }
}
