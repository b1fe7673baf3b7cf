//! `urg cut`: copies a part of a recording, or joins its files. Times stay as recorded.

use std::io::Write;
use std::path::PathBuf;

use urg_recording::{Copied, cut};

use crate::args::CopyArgs;
use crate::failure::Failure;
use crate::format::counted;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::recording::rewrite::{is_dash, rewrite};
use crate::recording::span::RangeArgs;

/// Copy a part of a recording, or join the files of a split recording
///
/// Messages of all topics keep their bytes and times, and are in the order of their times. You lose
/// only damaged parts, about one second each. The input files are not changed.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "urg cut [OPTIONS] <FILE>... <OUT>",
    after_help = "\
Examples:
  urg cut run.mcap part.mcap --range 1:30..2:00
  urg cut run*.mcap whole.mcap
  urg cut run.mcap plain.mcap --compress none
  urg cut run.mcap - --range 90s.. | ssh host 'cat > part.mcap'"
)]
pub(crate) struct Cut {
    /// Recordings to read, in any order, then the file to create, which must not exist yet;
    /// `-` means standard input or output
    #[arg(value_name = "FILE", required = true, num_args = 2..)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    range: RangeArgs,
    #[command(flatten)]
    copy: CopyArgs,
}

impl Cut {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { mut files, range, copy } = self;
        let Some(out) = files.pop() else { return Ok(()) };
        let name = out.display().to_string();
        let (bounds, compression) = (range.bounds(), copy.compression());
        let copy = move |inputs, output: &mut dyn Write| cut(inputs, bounds, compression, output);
        let is_kept = |copied: &Copied| copied.messages > 0;
        let copied = rewrite(files, &out, interrupt, copy, is_kept).await?;
        let Copied { messages, scans, damaged_parts, was_truncated, .. } = copied;
        if messages == 0 && !is_dash(&out) {
            return Err(Failure::Failed(format!("{name}: nothing in this part: see `urg info`")));
        }
        let mut text = format!("{name}: {}", counted(scans, "scan"));
        if damaged_parts > 0 {
            text.push_str(&format!(", {} left out", counted(damaged_parts, "damaged part")));
        }
        if was_truncated {
            text.push_str(", the end of a file that was read is missing or damaged");
        }
        notice(text);
        Ok(())
    }
}
