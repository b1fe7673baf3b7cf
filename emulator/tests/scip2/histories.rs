//! Random histories of commands, compared with a model: the states that a UST has names for.

use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::sleep;
use urg_emulator::{Link, Model};

use super::{MODELS, sensor};
use crate::listen;

#[derive(Debug, Clone, PartialEq, Eq)]
enum State {
    Standby,
    Clock,
    Single,
    /// The command, without its number of scans, and how many are left.
    Multi(String, Option<u32>),
    Asleep,
}

const COMMANDS: [&str; 16] = [
    "VV",
    "PP",
    "BM",
    "QT",
    "TM0",
    "TM1",
    "TM2",
    "RT",
    "GD0044004501",
    "GS0044072599",
    "MD0044004401000",
    "MS0044004501103",
    "MD0100010103099",
    "%ST",
    "%SL",
    "XX",
];

/// Status of the answer to a command, and the state after it.
fn answer(model: Model, state: &State, command: &str) -> (&'static str, State) {
    use State::{Asleep, Clock, Multi, Single, Standby};
    let is_ust = model == Model::Ust10lx;
    let same = |status| (status, state.clone());
    let unknown = same(if is_ust { "0Ff" } else { "0Ee" });
    let denied = same(if is_ust { "10Q" } else { "0Ee" });
    match (command, state) {
        ("XX", _) => unknown,
        ("%ST" | "%SL", _) if !is_ust => unknown,
        (short, _) if is_ust && ["GS", "MS"].contains(&&short[..2]) => unknown,
        ("VV" | "TM1" | "%ST", _) => same("00P"),
        ("RT", _) => ("00P", Standby),
        ("TM0", Clock) => same("02R"),
        ("TM0", Multi(..)) if is_ust => denied,
        ("TM0" | "BM", Asleep) => same("10Q"),
        ("TM0", _) => ("00P", Clock),
        ("TM2", Clock) => ("00P", Standby),
        ("TM2", _) => same("03S"),
        (_, Clock) => denied,
        ("PP", _) => same("00P"),
        ("QT", _) => ("00P", Standby),
        ("%SL", _) => ("00P", Asleep),
        ("BM", Standby) => ("00P", Single),
        ("BM", _) => same("02R"),
        (_, Asleep) => same("10Q"),
        (latest, Standby) if latest.starts_with('G') => same("10Q"),
        (latest, _) if latest.starts_with('G') => same("00P"),
        (stream, _) => {
            let (start, count) = stream.split_at(13);
            let count = count.parse().unwrap();
            ("00P", Multi(start.to_owned(), Some(count).filter(|count| *count > 0)))
        }
    }
}

/// Takes the next scan of a stream into account.
fn scan(state: &mut State, echo: &str, label: &str, status: &str) {
    let State::Multi(start, left) = state else { panic!("{echo} in {state:?}") };
    if let Some(left) = left {
        *left -= 1;
    }
    let expected = format!("{start}{:02};{label}", left.unwrap_or(0));
    assert_eq!((echo, status), (&expected[..], "99b"));
    if *left == Some(0) {
        *state = State::Standby;
    }
}

async fn play(model: Model, link: &mut Link, random: &mut impl FnMut(usize) -> usize) {
    let (mut state, mut stream) = (State::Standby, String::new());
    for number in 0..200 {
        let command = COMMANDS[random(COMMANDS.len())];
        let label = format!("n{number}");
        link.write_all(format!("{command};{label}\n").as_bytes()).await.unwrap();
        loop {
            let reply = listen(link).await;
            let mut lines = reply.lines();
            let (echo, status) = (lines.next().unwrap(), lines.next().unwrap());
            if !echo.ends_with(&format!(";{label}")) {
                scan(&mut state, echo, &stream, status);
                continue;
            }
            let (expected, next) = answer(model, &state, command);
            assert_eq!(status, expected, "{model:?} {number} {command} in {state:?}");
            if let ("%ST", "00P") = (command, expected) {
                let code = match state {
                    State::Standby => "000@",
                    State::Clock => "002B",
                    State::Single => "003C",
                    State::Multi(..) => "004D",
                    State::Asleep => "005E",
                };
                assert_eq!(lines.next(), Some(code));
            }
            if command.starts_with('M') && expected == "00P" {
                stream = label;
            }
            state = next;
            break;
        }
        sleep(Duration::from_millis(random(300) as u64)).await;
    }
    // What has been sent is what the state says.
    sleep(Duration::from_secs(20)).await;
    while let State::Multi(_, Some(_)) = state {
        let reply = listen(link).await;
        let mut lines = reply.lines();
        scan(&mut state, lines.next().unwrap(), &stream, lines.next().unwrap());
    }
    assert_eq!(listen(link).await.is_empty(), !matches!(state, State::Multi(..)));
}

#[tokio::test(start_paused = true)]
async fn a_sensor_is_in_the_state_of_its_history() {
    for (model, seed) in MODELS.into_iter().flat_map(|model| (0..25).map(move |seed| (model, seed)))
    {
        let mut word: u64 = seed;
        let mut random = |below: usize| {
            word = word
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (word >> 33) as usize % below
        };
        let mut link = sensor(model).build().link();
        play(model, &mut link, &mut random).await;
    }
}
