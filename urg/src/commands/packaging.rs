//! `urg completions` and `urg man`: shell completions, and manual pages for packagers.

use clap_complete::Shell;
use clap_mangen::Man;

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
    pub(crate) async fn run(self, mut program: clap::Command) -> Result<(), Failure> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut program, "urg", &mut script);
        print(String::from_utf8_lossy(&script)).await
    }
}

/// Write a manual page
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  urg man | man -l -
  urg man scan > urg-scan.1")]
pub(crate) struct Manual {
    /// Command to describe [default: the whole program]
    command: Option<String>,
}

impl Manual {
    /// Writes the page of one command of `program`, or of all of it.
    pub(crate) async fn run(self, mut program: clap::Command) -> Result<(), Failure> {
        let failed = |error: std::io::Error| Failure::new("cannot write the page", &error);
        // Gives the commands their full names and the global options.
        program.build();
        let about = match &self.command {
            None => program,
            Some(name) => program.find_subcommand(name).cloned().ok_or_else(|| {
                Failure::Usage(format!("unknown command {name:?}: `urg help` lists all commands"))
            })?,
        };
        let mut page = Vec::new();
        let title = about.get_display_name().unwrap_or("urg").to_owned();
        Man::new(about).title(title.to_uppercase()).render(&mut page).map_err(failed)?;
        print(String::from_utf8_lossy(&page)).await
    }
}
