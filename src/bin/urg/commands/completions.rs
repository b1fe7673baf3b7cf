//! `urg completions`: scripts with which shells complete command lines.

use clap_complete::Shell;

use crate::failure::Failure;
use crate::output::stdout::print;

/// Write completions for a shell
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  urg completions bash > ~/.local/share/bash-completion/completions/urg
  urg completions zsh > ~/.zfunc/_urg
  urg completions fish > ~/.config/fish/completions/urg.fish")]
pub(crate) struct Completions {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    /// Writes the completions of `program`, the whole command line.
    pub(crate) async fn run(self, mut program: clap::Command) -> Result<(), Failure> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut program, "urg", &mut script);
        print(&String::from_utf8_lossy(&script)).await
    }
}
