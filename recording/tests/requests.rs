//! What a recorded reply answers, from the text of its request.

use std::io::Cursor;

use tokio_scip::protocol::Command;
use tokio_scip::protocol::scip2::{self, Data, Label, Request};
use tokio_scip::{BaudRate, Window};
use urg_recording::{Entry, Recording};

use super::raw::{MAGIC, channel_content, end, of_kind, text};

fn answered(request: &str) -> (Option<Command>, Option<Request>) {
    let mut data = [&[0, 1, 0, 0, 1, 0, 0, 0][..], &text(&format!("{request}\0"))].concat();
    // Size, stride, offset and no bytes.
    data.resize(data.len().next_multiple_of(4) + 16, 0);
    let channel = of_kind(0x04, &channel_content(0, "/scip/replies"));
    let message = of_kind(0x05, &[&[0; 22][..], &data].concat());
    let file = [MAGIC, &channel, &message, &end()].concat();
    let record = Recording::read(Cursor::new(file)).unwrap().next().unwrap().unwrap();
    let Entry::Reply(reply) = record.entry else { panic!("{record:?}") };
    (reply.command, reply.request)
}

#[test]
fn every_command_parses_back_from_its_text() {
    let window = Window::new(3..=768).and_then(|window| window.with_cluster_count(99)).unwrap();
    let commands = [Command::Version, Command::LaserOn, Command::LaserOff]
        .into_iter()
        .chain(BaudRate::ALL.into_iter().map(Command::BaudRate))
        .chain([Command::Distances(window), Command::Distances(Window::FULL)]);
    for command in commands {
        let text = command.to_string();
        assert_eq!(answered(&text), (Some(command), None));
    }
    let window = Window::new(3..=1080).and_then(|window| window.with_cluster_count(99)).unwrap();
    let polls =
        [Data::Distances, Data::Intensities].map(|data| scip2::Command::Latest { data, window });
    let fixed = [scip2::Command::Version, scip2::Command::Parameters];
    for command in polls.into_iter().chain(fixed) {
        for label in [None, Label::new("00005xjj").ok()] {
            let request = Request::new(command, label);
            let text = std::str::from_utf8(request.bytes()).unwrap();
            assert_eq!(answered(text), (None, Some(request)));
        }
    }
    for text in [
        "",
        "G",
        "G00076800",
        "G00076901",
        "G76800001",
        "G+0076801",
        "Gx0076801",
        "G\u{e9}\u{e9}\u{e9}\u{e9}",
        "X",
        "GD",
        "GD0000108000",
        "GD108000001",
        "GD0000108001;\u{e9}",
        "VV;",
    ] {
        assert_eq!(answered(text), (None, None), "{text}");
    }
}
