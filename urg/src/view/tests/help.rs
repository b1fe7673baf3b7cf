//! The help over the picture: its keys, and how it scrolls on small screens.

use super::*;

#[tokio::test(start_paused = true)]
async fn help_covers_the_radar_until_a_key() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    press(&mut model, KeyCode::Char('?'));
    for (width, height) in [(80, 24), (160, 50), (40, 12)] {
        let help = screen(&model, width, height);
        assert!(help.contains("zoom in and out"), "{help}");
    }
    let help = screen(&model, 80, 24);
    assert!(help.contains("too little light came back") && help.contains("Ctrl-C"), "{help}");
    assert_eq!(press(&mut model, KeyCode::Char('w')), None);
    assert!(!screen(&model, 80, 24).contains("zoom in and out"));
    assert!(matches!(press(&mut model, KeyCode::Char('w')), Some(Action::Watch(_))));
}

#[tokio::test(start_paused = true)]
async fn the_help_scrolls_to_its_end() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    let small = screen(&model, 40, 12);
    assert!(small.contains("?  help") && small.contains("q  quit"), "{small}");
    assert!(!small.contains("w  window"), "{small}");
    press(&mut model, KeyCode::Char('?'));
    assert!(!screen(&model, 40, 12).contains("x none"));
    let drawn = |model: &Model, width, height| {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let mut first_line = None;
        terminal.draw(|frame| first_line = draw(frame, model, Palette::Coloured)).unwrap();
        first_line
    };
    for _ in 0..3 {
        press(&mut model, KeyCode::Down);
        model.help = drawn(&model, 80, 60);
        assert_eq!(model.help, Some(0), "all of it is on the screen");
    }
    for _ in 0..100 {
        press(&mut model, KeyCode::Down);
        model.help = drawn(&model, 40, 12);
    }
    let small = screen(&model, 40, 12);
    assert!(small.contains("x none") && small.contains("q  quit"), "{small}");
    let end = model.help.unwrap();
    press(&mut model, KeyCode::Up);
    assert_eq!(drawn(&model, 40, 12), Some(end - 1), "one key scrolls it back");
}
