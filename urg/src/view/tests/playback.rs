//! Playback of a recording on the screen.

use super::*;
use crate::playback::{PlaybackCommand, PlaybackStatus};

fn played(scan: usize, paused: bool) -> PlaybackStatus {
    let position = scan as f64 / 10.0;
    let (scans, length) = (621, 62.0);
    let ended = position >= length;
    let (speed, is_looping) = (1.0, false);
    PlaybackStatus { scan, scans, position, length, paused, ended, speed, is_looping }
}

#[tokio::test(start_paused = true)]
async fn a_playback_shows_its_place_instead_of_a_link() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    model.playback = Some(played(123, false));
    let playing = screen(&model, 80, 24);
    let parts = "file    playing|time    0:12 of 1:02|scan    124 of 621|speed   1x|steps   44 to 725|\
                 \u{25b6}  0:12 \u{2501}|\u{2500} 1:02 1x|, .  step|q  quit";
    for part in parts.split('|') {
        assert!(playing.contains(part), "{part:?} is missing in\n{playing}");
    }
    for part in ["link", "latency", "lost"] {
        assert!(!playing.contains(part), "{part:?} in\n{playing}");
    }
    model.playback = Some(played(123, true));
    assert!(screen(&model, 80, 24).contains("PAUSED at 0:12"));
    model.playback = Some(played(620, false));
    assert!(screen(&model, 80, 24).contains(" END "));
    let small = screen(&model, 40, 12);
    assert!(small.contains("1:02 1x") && small.contains("q  quit"), "{small}");
}

#[tokio::test(start_paused = true)]
async fn playback_keys_move_the_playback() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    model.playback = Some(played(123, false));
    for (code, command) in [
        (KeyCode::Char(' '), PlaybackCommand::Toggle),
        (KeyCode::Char(','), PlaybackCommand::Step(-1)),
        (KeyCode::Char('.'), PlaybackCommand::Step(1)),
        (KeyCode::Left, PlaybackCommand::SeekBy(-5.0)),
        (KeyCode::Right, PlaybackCommand::SeekBy(5.0)),
        (KeyCode::Home, PlaybackCommand::Seek(0.0)),
        (KeyCode::End, PlaybackCommand::Seek(62.0)),
        (KeyCode::Char(']'), PlaybackCommand::Speed(2.0)),
        (KeyCode::Char('['), PlaybackCommand::Speed(0.5)),
        (KeyCode::Char('o'), PlaybackCommand::Loop(true)),
    ] {
        assert_eq!(press(&mut model, code), Some(Action::Playback(command)), "{code:?}");
    }
    let minute = model.key(KeyEvent::new(KeyCode::Left, KeyModifiers::SHIFT));
    assert_eq!(minute, Some(Action::Playback(PlaybackCommand::SeekBy(-60.0))));
    assert!(matches!(press(&mut model, KeyCode::Char('w')), Some(Action::Watch(_))));
    press(&mut model, KeyCode::Char('?'));
    let help = screen(&model, 80, 24);
    for part in ["The picture:", "The recording:", "5 s back and on", "x none"] {
        assert!(help.contains(part), "{part:?} is missing in\n{help}");
    }
    assert_eq!(press(&mut model, KeyCode::Right), None, "it closes the help");
}

#[tokio::test(start_paused = true)]
async fn a_new_window_redraws_the_same_scan() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    let scan = model.layers[0].scan.clone().unwrap();
    model.layers[0].window = Window::FULL;
    model.moved(&scan, played(49, false));
    assert_eq!(model.layers[0].scan.as_ref().map(tokio_scip::Scan::window), Some(Window::FULL));
}
