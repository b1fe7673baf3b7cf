//! `urg repair`: restores a truncated or damaged recording.

use std::io::Write;
use std::path::PathBuf;

use urg_recording::{Copied, cut};

use crate::args::CopyArgs;
use crate::failure::Failure;
use crate::format::counted;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::recording::rewrite::{is_dash, rewrite};

/// Restore a recording that is truncated or damaged
///
/// If `urg record` is killed or the disk fills up, the recording has no end. `ros2 bag`, rosbags and
/// others do not open such a file. This command copies every message unchanged to a new file, and adds
/// the index and the end. You lose only damaged parts, about one second each. FILE is not changed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  urg repair cut.mcap                    writes cut.repaired.mcap
  urg repair cut.mcap whole.mcap
  ssh robot cat cut.mcap | urg repair - whole.mcap")]
pub(crate) struct Repair {
    /// Recording to read: FILE.mcap, or - for standard input, which needs OUT
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// File to create; must not exist yet [default: FILE.repaired.mcap]
    #[arg(value_name = "OUT")]
    out: Option<PathBuf>,
    #[command(flatten)]
    copy: CopyArgs,
}

impl Repair {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { file, out, copy } = self;
        if out.as_deref().map_or(is_dash(&file), is_dash) {
            let text = "standard input has no name, and the copy must be a file: `urg repair - \
                        whole.mcap` names it";
            return Err(Failure::Usage(text.to_owned()));
        }
        let out = out.unwrap_or_else(|| file.with_extension("repaired.mcap"));
        let compression = copy.compression();
        let copy = move |inputs, output: &mut dyn Write| cut(inputs, .., compression, output);
        let is_kept = |copied: &Copied| {
            copied.messages > 0 && (copied.was_truncated || copied.damaged_parts > 0)
        };
        let copied = rewrite(vec![file.clone()], &out, interrupt, copy, is_kept).await?;
        let (file, out) = (file.display(), out.display());
        match copied {
            Copied { was_truncated: false, damaged_parts: 0, .. } => {
                notice(format_args!("{file} is complete: nothing to repair, {out} not written"));
            }
            Copied { messages: 0, .. } => {
                return Err(Failure::Failed(format!(
                    "{file}: no message in it can be read: nothing to repair, {out} not written"
                )));
            }
            Copied { scans, was_truncated, damaged_parts, damaged_at, .. } => {
                let mut found = Vec::new();
                if was_truncated {
                    found.push("its end was missing or damaged".to_owned());
                }
                if let Some(first) = damaged_at.first() {
                    let parts = counted(damaged_parts, "damaged part");
                    found.push(format!("{parts} left out, the first at byte {first}"));
                }
                let scans = counted(scans, "scan");
                notice(format_args!("{out}: {scans}, complete ({file}: {})", found.join("; ")));
            }
        }
        Ok(())
    }
}
