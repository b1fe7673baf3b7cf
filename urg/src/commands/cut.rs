//! `urg cut`: copies a part of a recording, or joins its files. Times stay as recorded.

use std::io::Write;
use std::path::PathBuf;

use urg_recording::{Copied, Recording, RecordingError, cut_topic};

use crate::args::CopyArgs;
use crate::failure::Failure;
use crate::format::counted;
use crate::interrupt::Interrupt;
use crate::output::notice::notice;
use crate::recording::rewrite::{is_dash, rewrite};
use crate::recording::span::{RangeArgs, TopicArgs};

/// Copy a part of a recording, or join the files of a split recording
///
/// Messages of all topics keep their bytes and times, and are in the order of their times. You lose
/// only damaged parts, about one second each. The input files are not changed.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "urg cut [OPTIONS] <FILE>... <OUT>",
    mut_arg("topic", |topic| topic.requires("range").help("Topic whose first scan --range counts \
        from, such as /front/scan: all topics are copied [default: /scan]")),
    after_help = "\
Examples:
  urg cut run.mcap part.mcap --range 1:30..2:00
  urg cut run*.mcap whole.mcap
  urg cut bag.mcap part.mcap --range 90s.. --topic /front/scan
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
    topic: TopicArgs,
    #[command(flatten)]
    copy: CopyArgs,
}

/// Times count from the first scan on the topic: fails if the file has none.
fn find_scan(file: &PathBuf, topic: &str) -> Result<(), RecordingError> {
    match Recording::open(file)?.topic(topic).scans().next() {
        Some(Err(error @ RecordingError::NoScans { .. })) => Err(error),
        _ => Ok(()),
    }
}

impl Cut {
    pub(crate) async fn run(self, interrupt: &Interrupt) -> Result<(), Failure> {
        let Self { mut files, range, topic, copy } = self;
        let Some(out) = files.pop() else { return Ok(()) };
        let name = out.display().to_string();
        let (bounds, compression) = (range.bounds(), copy.compression());
        let (inputs, topic) = (files.clone(), topic.topic.unwrap_or_else(|| "/scan".to_owned()));
        let copy = move |files, output: &mut dyn Write| {
            let copied = cut_topic(files, &topic, bounds, compression, output)?;
            let is_doubtful = range.range.is_some() && copied.scans == 0;
            // Standard input cannot be read again.
            let doubtful = inputs.iter().filter(|file| is_doubtful && !is_dash(file));
            let found = doubtful.map(|file| find_scan(file, &topic)).reduce(Result::or);
            found.unwrap_or(Ok(())).map(|()| copied)
        };
        let is_kept = |copied: &Copied| copied.messages > 0;
        let copied = rewrite(files, &out, interrupt, copy, is_kept).await?;
        let Copied { messages, scans, damaged_parts, was_truncated, .. } = copied;
        if messages == 0 && !is_dash(&out) {
            let part = range.range.map_or("the files", |_| "this part");
            return Err(Failure::Failed(format!("{name}: nothing in {part}: see `urg info`")));
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
