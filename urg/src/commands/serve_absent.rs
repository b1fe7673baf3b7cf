//! `urg serve` in a build without the feature `serve`: accepts any arguments, and names the feature.

use std::ffi::OsString;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Serve a live page: not in this build, add `--features serve`
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Serve {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _arguments: Vec<OsString>,
}

impl Serve {
    pub(crate) async fn run(self, _: &Interrupt) -> Result<(), Failure> {
        Err(Failure::Usage(
            "`urg serve` is not in this build: build urg with the feature `serve`, which it has unless you leave it out (`cargo install --path urg`)"
                .to_owned(),
        ))
    }
}
