//! Draws the radar into memory, with emulated sensors on the paused clock.

mod help;
mod playback;
mod several;

use std::time::Duration;

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::style::Color;
use tokio_scip::{BaudRate, Rate, Sensor, State, Window};
use urg_emulator::{Emulator, STEPS, Values, WorldTime};

use super::draw::draw;
use super::layer::Layer;
use super::model::{Action, Model};
use super::palette::Palette;
use crate::picture::PictureSource;
use crate::port::named::{NamedPort, PlacedPort};

/// Values of a sensor whose view never changes.
type Sight = [u32; STEPS];

fn seen(sight: Sight) -> Emulator {
    let world = move |_: WorldTime, codes: &mut Values| codes.copy_from_slice(&sight);
    Emulator::builder().usb().world(world).build()
}

/// Sensor that sees one object, two metres ahead.
fn ahead() -> Emulator {
    let mut sight = [7; STEPS];
    sight[384] = 2000;
    seen(sight)
}

/// Source that is not recorded, with the default window and rate.
fn source(port: &str) -> PictureSource {
    let PlacedPort { named: NamedPort { name, port }, pose } = port.parse().unwrap();
    PictureSource { name, port, pose, window: Window::DETECTION, rate: Rate::hz(10.0) }
}

async fn model_for(sensor: &Sensor) -> Model {
    Model::new(vec![Layer {
        version: Some(sensor.version().await.unwrap()),
        state: sensor.watch_state().get(),
        stats: sensor.stats(),
        ..Layer::new(source("/dev/ttyACM0"))
    }])
}

/// Polls a sensor for five seconds and shows its last scan.
async fn watched(emulator: Emulator) -> Model {
    let sensor = Sensor::builder().connect(emulator).await.unwrap();
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
    let mut last = None;
    for _ in 0..50 {
        last = scans.next().await;
    }
    let mut model = model_for(&sensor).await;
    model.scanned(0, last.unwrap().unwrap());
    model
}

/// Unplugs a sensor, and shows it `seconds` later.
async fn lose(model: &mut Model, at: usize, emulator: &Emulator, sensor: &Sensor, seconds: u64) {
    emulator.unplug();
    let mut state = sensor.watch_state();
    let lost = state.wait_for(|state| matches!(state, State::Disconnected { .. })).await;
    model.layers[at].state = lost.unwrap().clone();
    if let State::Disconnected { since, .. } = &model.layers[at].state {
        model.now = *since + Duration::from_secs(seconds);
    }
}

/// Shows `count` scans of a sensor.
async fn scanned(count: usize) -> (Sensor, Model) {
    let sensor = Sensor::builder().connect(Emulator::builder().build()).await.unwrap();
    let mut model = model_for(&sensor).await;
    for _ in 0..count {
        model.scanned(0, sensor.scan(Window::DETECTION).await.unwrap());
    }
    (sensor, model)
}

fn terminal(model: &Model, width: u16, height: u16, palette: Palette) -> Terminal<TestBackend> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| _ = draw(frame, model, palette)).unwrap();
    terminal
}

/// Symbols of each row.
fn symbols(terminal: &Terminal<TestBackend>) -> Vec<String> {
    let buffer = terminal.backend().buffer();
    let row = |row: &[ratatui::buffer::Cell]| row.iter().map(|cell| cell.symbol()).collect();
    buffer.content().chunks(buffer.area.width.into()).map(row).collect()
}

fn rows(model: &Model, width: u16, height: u16) -> Vec<String> {
    symbols(&terminal(model, width, height, Palette::Coloured))
}

fn screen(model: &Model, width: u16, height: u16) -> String {
    rows(model, width, height).join("\n")
}

fn press(model: &mut Model, code: KeyCode) -> Option<Action> {
    model.key(KeyEvent::new(code, KeyModifiers::NONE))
}

fn is_braille(symbol: char) -> bool {
    ('\u{2801}'..='\u{28ff}').contains(&symbol)
}

#[tokio::test(start_paused = true)]
async fn everything_is_there_in_80x24_and_in_160x50() {
    let model = watched(Emulator::builder().usb().build()).await;
    for (width, height) in [(80, 24), (160, 50)] {
        let screen = screen(&model, width, height);
        let parts = "/dev/ttyACM0  SOKUIKI Sensor URG-04LX H0713090|link    connected|line    USB|\
                     steps   44 to 725|-119.5° to 119.9°|rate    10.0 of 10 Hz|latency |lost    0|\
                     1 m|2 m|3 m|4 m| 0°| 30°|-30°|of 682|^ far |~ weak |x none |?  help|q  quit";
        for part in parts.split('|') {
            assert!(screen.contains(part), "{part:?} is missing in\n{screen}");
        }
        // Scan and grid differ even without colours.
        assert!(screen.chars().filter(|symbol| is_braille(*symbol)).count() > 50, "{screen}");
        assert!(screen.matches('·').count() > 100, "{screen}");
    }
    assert!(screen(&model, 160, 50).contains("-90°"));
}

#[tokio::test(start_paused = true)]
async fn a_narrow_screen_keeps_the_main_figures() {
    let model = watched(Emulator::builder().usb().build()).await;
    let narrow = screen(&model, 50, 20);
    assert!(narrow.contains("of 682 points, 10.0 Hz"), "{narrow}");
    assert!(narrow.contains("4 m") && !narrow.contains("latency"), "{narrow}");
    for (width, height) in [(29, 24), (80, 9), (10, 3), (1, 1)] {
        let tiny = rows(&model, width, height);
        assert!("too small:".starts_with(tiny[0].trim()), "{tiny:?}");
    }
    // Odd sizes must not panic.
    for width in (30..200).step_by(7) {
        for height in (10..60).step_by(5) {
            terminal(&model, width, height, Palette::Coloured);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_point_is_where_it_was_measured() {
    let mut model = watched(ahead()).await;
    let find = |model: &Model| {
        let rows = rows(model, 80, 24);
        let sensor = rows.iter().position(|row| row.contains('▲')).unwrap();
        let column = rows[sensor].chars().position(|symbol| symbol == '▲').unwrap();
        let terminal = terminal(model, 80, 24, Palette::Coloured);
        let near = Palette::Coloured.distance(2.0, 0.5);
        let buffer = terminal.backend().buffer().clone();
        let at = |row: usize| buffer[(column as u16, row as u16)].fg == near;
        // Number of rows from the sensor to its point.
        (1..sensor).filter(|row| at(sensor - row)).collect::<Vec<_>>()
    };
    let whole = find(&model);
    assert_eq!(whole.len(), 1, "{}", screen(&model, 80, 24));
    assert!(screen(&model, 80, 24).contains("nearest 2.000 m at 0°"));
    // Zooming from 4.2 to 3 metres moves the point outward.
    press(&mut model, KeyCode::Char('+'));
    let closer = find(&model);
    assert!(closer[0] > whole[0], "{whole:?} {closer:?}");
    // At 1 metre the point is out of sight, and the panel counts it.
    press(&mut model, KeyCode::Char('+'));
    press(&mut model, KeyCode::Char('+'));
    assert_eq!(find(&model), [0; 0]);
    assert!(screen(&model, 80, 24).contains("outside 1 beyond the rim"));
}

#[tokio::test(start_paused = true)]
async fn error_codes_are_marked_at_the_rim() {
    let mut sight = [0; STEPS];
    sight[300..500].fill(3);
    sight[600..].fill(19);
    let model = watched(seen(sight)).await;
    let screen = screen(&model, 80, 24);
    assert!(screen.contains("^ far   356"), "{screen}");
    assert!(screen.contains("~ weak  200"), "{screen}");
    assert!(screen.contains("x none  126"), "{screen}");
    assert!(screen.contains("points  0 of 682"), "{screen}");
    assert!(screen.contains("nearest -"), "{screen}");
    // Weak ahead, nothing on the left, far in between and on the right.
    let rim = rows(&model, 80, 24)[2].clone();
    assert!(rim.contains("~~~~~"), "{rim}");
    for mark in ["^", "~", "x"] {
        assert!(screen.matches(mark).count() > 5, "{mark} in\n{screen}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_cell_shows_most_of_its_directions() {
    let mut sight = [3; STEPS];
    sight.iter_mut().step_by(4).for_each(|code| *code = 0);
    let rows = rows(&watched(seen(sight)).await, 80, 24);
    // Skip the title, and cut off the panel on the right.
    let radar: String = rows[1..].iter().flat_map(|row| row.chars().take(52)).collect();
    let (weak, far) = (radar.matches('~').count(), radar.matches('^').count());
    assert!(weak > 20 && far == 0, "{weak} weak, {far} far\n{}", rows.join("\n"));
}

#[tokio::test(start_paused = true)]
async fn zooming_changes_the_rings_between_its_ends() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    let mut reaches = vec![model.reach()];
    for _ in 0..9 {
        assert_eq!(press(&mut model, KeyCode::Char('+')), None);
        reaches.push(model.reach());
    }
    assert!(reaches.is_sorted_by(|a, b| a >= b) && reaches[9] == 0.5, "{reaches:?}");
    let close = screen(&model, 80, 24);
    assert!(close.contains("0.1 m") && close.contains("0.5 m"), "{close}");
    press(&mut model, KeyCode::Char('-'));
    assert_eq!(model.reach(), 1.0);
    press(&mut model, KeyCode::Char('0'));
    press(&mut model, KeyCode::Char('-'));
    assert_eq!(model.reach(), reaches[0]);
}

#[tokio::test(start_paused = true)]
async fn a_rate_is_shown_from_the_second_scan_on() {
    for (scans, expected) in [(1, "of 682 points, - Hz"), (2, "of 682 points, 10.0 Hz")] {
        let (_, model) = scanned(scans).await;
        let small = screen(&model, 40, 12);
        assert!(small.contains(expected), "{small}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_paused_picture_stays_and_is_marked() {
    let (sensor, mut model) = scanned(1).await;
    let shown = |model: &Model| model.layers[0].scan.as_ref().map(|scan| scan.received_at());
    let before = shown(&model);
    press(&mut model, KeyCode::Char(' '));
    model.scanned(0, sensor.scan(Window::DETECTION).await.unwrap());
    assert_eq!(shown(&model), before);
    assert!(screen(&model, 80, 24).contains("PAUSED at scan 0"));
    press(&mut model, KeyCode::Char(' '));
    model.scanned(0, sensor.scan(Window::DETECTION).await.unwrap());
    assert!(!screen(&model, 80, 24).contains("PAUSED"));
    assert!(shown(&model) > before);
}

#[tokio::test(start_paused = true)]
async fn keys_request_windows_pictures_and_the_end() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    let steps = |action| match action {
        Some(Action::Watch(window)) => (window.start(), window.end(), window.cluster_count()),
        other => panic!("{other:?}"),
    };
    let mut key = |code| press(&mut model, code);
    assert_eq!(steps(key(KeyCode::Char('w'))), (128, 640, 1));
    assert_eq!(steps(key(KeyCode::Char('c'))), (128, 640, 2));
    assert_eq!(steps(key(KeyCode::Char('w'))), (256, 512, 2));
    assert_eq!(steps(key(KeyCode::Char('w'))), (0, 768, 2));
    assert_eq!(steps(key(KeyCode::Char('w'))), (44, 725, 2));
    assert_eq!(key(KeyCode::Char('q')), Some(Action::Quit));
    let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert_eq!(model.key(control_c), Some(Action::Quit));
}

#[tokio::test(start_paused = true)]
async fn a_lost_link_is_shown_as_long_as_it_lasts() {
    let emulator = Emulator::builder().baud_rate(BaudRate::B19200).build();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    let scan = sensor.scan(Window::DETECTION).await.unwrap();
    let mut model = model_for(&sensor).await;
    model.scanned(0, scan);
    assert!(screen(&model, 80, 24).contains("line    19200 baud"));
    lose(&mut model, 0, &emulator, &sensor, 12).await;
    let lost = screen(&model, 80, 24);
    assert!(lost.contains("LOST for 12 s"), "{lost}");
    assert!(lost.contains("continues when the sensor is back"), "{lost}");
    emulator.plug_in();
    let mut state = sensor.watch_state();
    let back = state.wait_for(|state| matches!(state, State::Connected { .. })).await;
    model.layers[0].state = back.unwrap().clone();
    assert!(screen(&model, 80, 24).contains("link    connected"));
}

#[tokio::test(start_paused = true)]
async fn lost_scans_are_counted_by_cause() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    let stats = &mut model.layers[0].stats;
    (stats.timeouts, stats.refused, stats.lost) = (3, 1, 6);
    let screen = screen(&model, 80, 24);
    for part in ["lost    3 unanswered", "        1 refused", "        2 on the way", "4 m"] {
        assert!(screen.contains(part), "{part:?} is missing in\n{screen}");
    }
}

#[tokio::test(start_paused = true)]
async fn messages_are_shown_whole_and_go_by_themselves() {
    let mut model = watched(Emulator::builder().usb().build()).await;
    model.show("so much to say ".repeat(12) + "and the end");
    assert!(screen(&model, 80, 24).contains("and the end"));
    model.now += Duration::from_secs(7);
    assert!(!screen(&model, 80, 24).contains("and the end"));
}
