//! Properties of the protocol's types that hold for all bytes and all windows.

use proptest::prelude::*;
use tokio_scip::protocol::{BaudRate, Command, Reply, Text, Version, Window};

use super::encoder;

use crate::common::reply_len;

fn windows() -> impl Strategy<Value = Window> {
    (0..=768_u16, 0..=768_u16, 1..=99_u8).prop_map(|(one, other, cluster_count)| {
        let steps = one.min(other)..=one.max(other);
        Window::new(steps).unwrap().with_cluster_count(cluster_count).unwrap()
    })
}

fn commands() -> impl Strategy<Value = Command> {
    prop_oneof![
        Just(Command::Version),
        Just(Command::LaserOn),
        Just(Command::LaserOff),
        prop::sample::select(&BaudRate::ALL[..]).prop_map(Command::BaudRate),
        windows().prop_map(Command::Distances),
    ]
}

/// Bytes of a bad line, mostly those that replies consist of.
fn noise() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![4 => 0x30..=0x6f_u8, 2 => Just(b'\n'), 1 => any::<u8>()];
    prop::collection::vec(byte, 0..200)
}

fn scan() -> impl Strategy<Value = (Window, Vec<u16>)> {
    windows()
        .prop_flat_map(|window| (Just(window), prop::collection::vec(0..4096_u16, window.points())))
}

fn echo(window: Window) -> String {
    format!("G{:03}{:03}{:02}", window.start(), window.end(), window.cluster_count())
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(command in commands(), noise in noise(), status: u8, begin in 0..4) {
        let begin = match begin {
            0 => vec![],
            1 => command.bytes().to_vec(),
            2 => [&command.bytes()[..], b"\n0\n"].concat(),
            _ => [&command.bytes()[..], b"\n", &[status]].concat(),
        };
        let frame = [begin, noise].concat();
        for reply in [Reply::parse(&command, &frame), Reply::parse_end(&command, &frame)] {
            match reply {
                Ok(reply) => {
                    prop_assert!(reply.values().iter().all(|&value| value < 4096));
                    prop_assert!(Version::from_reply(&reply).other.len() <= frame.len());
                }
                Err(error) => prop_assert!(error.to_string().is_ascii()),
            }
        }
    }

    #[test]
    fn what_a_sensor_encodes_is_what_comes_out((window, sent) in scan()) {
        let reply = encoder::reply(&echo(window), &sent);
        prop_assert_eq!(reply.len(), reply_len(window));
        let command = Command::Distances(window);
        let parsed = Reply::parse(&command, &reply[..reply.len() - 2]).unwrap();
        prop_assert_eq!(parsed.values(), sent);
    }

    #[test]
    fn what_is_accepted_has_the_shape_of_its_command(
        (window, sent) in scan(), at: prop::sample::Index, remove in 0..70_usize, noise in noise(),
    ) {
        let mut frame = encoder::frame(&echo(window), &sent);
        let shape = |frame: &[u8]| -> Vec<bool> { frame.iter().map(|&byte| byte == b'\n').collect() };
        let right = shape(&frame);
        let at = at.index(frame.len());
        let end = frame.len().min(at + remove);
        frame.splice(at..end, noise);
        if Reply::parse(&Command::Distances(window), &frame).is_ok_and(|reply| reply.status.is_ok()) {
            prop_assert_eq!(shape(&frame), right);
            prop_assert!(frame[12..].iter().all(|byte| matches!(byte, b'\n' | 0x30..=0x6f)));
        }
    }

    #[test]
    fn no_reply_answers_a_command_with_other_bytes((window, sent) in scan(), command in commands()) {
        prop_assume!(&*command.bytes() != echo(window).as_bytes());
        let frame = encoder::frame(&echo(window), &sent);
        prop_assert!(Reply::parse(&command, &frame).is_err());
        prop_assert!(Reply::parse_end(&command, &frame).is_err());
    }

    #[test]
    fn degrees_hold_every_step_inside_and_none_outside(one in -140.0..140.0_f64, other in -140.0..140.0_f64) {
        let (from, to) = (one.min(other), one.max(other));
        let inside: Vec<u16> = (0..=768)
            .filter(|step| (from..=to).contains(&((f64::from(*step) - 384.0) * 0.351_562_5)))
            .collect();
        match Window::degrees(from..=to) {
            Ok(window) => {
                prop_assert_eq!(Some(&window.start()), inside.first());
                prop_assert_eq!(Some(&window.end()), inside.last());
            }
            Err(_) => prop_assert!(from < -135.0 || to > 135.0 || inside.is_empty()),
        }
    }

    #[test]
    fn any_numbers_make_a_window_or_an_error(from: f64, to: f64, start: u16, end: u16, cluster: u8) {
        let _ = Window::degrees(from..=to);
        let valid = start <= end && end <= 9999 && (1..=99).contains(&cluster);
        let window = Window::new(start..=end).and_then(|window| window.with_cluster_count(cluster));
        prop_assert_eq!(window.is_ok(), valid);
    }

    #[test]
    fn text_shows_any_bytes_on_one_line_of_ascii(bytes: Vec<u8>) {
        let shown = Text::from(&bytes[..]).to_string();
        prop_assert!(shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)));
    }
}
