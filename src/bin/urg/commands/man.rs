//! `urg man`: the manual pages, for packagers.

use clap_mangen::Man;

use crate::failure::Failure;
use crate::output::stdout::print;

/// Write a manual page
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  urg man | man -l -
  urg man scan > urg-scan.1")]
pub(crate) struct Manual {
    /// Command to describe; by default the whole program
    command: Option<String>,
}

impl Manual {
    /// Writes the page of one command of `program`, the whole command line.
    pub(crate) async fn run(self, mut program: clap::Command) -> Result<(), Failure> {
        let failed = |error: std::io::Error| Failure::of("cannot write the page", &error);
        // Commands get their full names and the options that all have.
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
        print(&String::from_utf8_lossy(&page)).await
    }
}
