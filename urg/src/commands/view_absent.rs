//! `urg view` in a build without the feature `view`: accepts any arguments, and names the feature.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Show a live radar: not in this build, add `--features view`
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct View {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _arguments: Vec<OsString>,
}

impl View {
    pub(crate) async fn run(self, _: &Interrupt) -> Result<(), Failure> {
        Err(Failure::Usage(
            "`urg view` is not in this build: build urg with the feature `view`, which it has unless you leave it out (`cargo install --path urg`)"
                .to_owned(),
        ))
    }
}
