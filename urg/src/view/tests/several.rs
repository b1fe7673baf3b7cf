//! Several sensors on one screen.

use super::*;
use tokio_scip::scan::Pose;
use tokio_scip::{Error, Scan, ScanStream};

use crate::plot::colours::{INTENSITIES, SENSORS, WEAK_SENSORS};
use crate::view::Viewer;
use crate::view::palette::Palette;

/// Shows sensors with these names and poses after five seconds.
async fn placed(sensors: &[(&str, Pose)]) -> Model {
    let mut layers = Vec::new();
    for (name, pose) in sensors {
        let layer = watched(ahead()).await.layers.remove(0);
        layers.push(Layer { name: Some((*name).to_owned()), pose: *pose, ..layer });
    }
    Model::new(layers)
}

fn pose(x: f64, y: f64, yaw: f64) -> Pose {
    Pose { x, y, heading: yaw.to_radians(), upside_down: false }
}

/// Unplugs a sensor, and shows it `seconds` later.
async fn unplug(model: &mut Model, number: usize, seconds: u64) {
    let emulator = ahead();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    lose(model, number, &emulator, &sensor, seconds).await;
}

async fn front_and_rear() -> Model {
    placed(&[("front", pose(0.2, 0.0, 0.0)), ("rear", pose(-0.2, 0.0, 180.0))]).await
}

/// Rows and columns of the radar's Braille cells in `color`.
fn cells_in(model: &Model, color: Color) -> Vec<(u16, u16)> {
    let (width, height) = (80, 24);
    let terminal = terminal(model, width, height, Palette::Coloured);
    let buffer = terminal.backend().buffer();
    let is_own = |&(row, column): &(u16, u16)| {
        let cell = &buffer[(column, row)];
        cell.fg == color && cell.symbol().chars().all(|symbol| is_braille(symbol) || symbol == '○')
    };
    let all = (0..height).flat_map(|row| (0..52).map(move |column| (row, column)));
    all.filter(is_own).collect()
}

fn place_of(model: &Model, sign: &str) -> (u16, u16) {
    let rows = rows(model, 80, 24);
    let at = |row: &String| row.find(sign).map(|at| row[..at].chars().count() as u16);
    let found = rows.iter().enumerate().find_map(|(row, text)| Some((row as u16, at(text)?)));
    found.unwrap_or_else(|| panic!("no {sign} in\n{}", rows.join("\n")))
}

#[tokio::test(start_paused = true)]
async fn each_sensor_has_its_colour_its_place_and_its_direction() {
    let model = front_and_rear().await;
    let (front, rear) = (place_of(&model, "▲1"), place_of(&model, "▼2"));
    let point = |number| {
        let cells = cells_in(&model, Palette::Coloured.sensor(number));
        assert_eq!(cells.len(), 1, "{number}: {cells:?}");
        cells[0]
    };
    // The front sensor's point is above it, the rear sensor's point below it.
    assert!(point(0).0 + 3 < front.0, "{:?} {front:?}", point(0));
    assert!(point(1).0 > rear.0 + 3, "{:?} {rear:?}", point(1));
    // A sensor on the left that faces right sees its object on the right.
    let across = placed(&[("a", pose(0.0, 3.0, -90.0)), ("b", pose(0.0, -3.0, 90.0))]).await;
    let (left, right) = (place_of(&across, "▶1"), place_of(&across, "◀2"));
    assert!(left.1 < right.1, "{left:?} {right:?}");
    let seen = cells_in(&across, Palette::Coloured.sensor(0));
    assert!(seen.iter().any(|cell| cell.1 > left.1 + 2), "{seen:?} {left:?}");
}

/// A UST that sees a wall at these millimetres, in the front half.
async fn ust(millimetres: u32) -> Layer {
    let world = move |_: WorldTime, values: &mut Values| {
        values.fill(65_533);
        values.iter_mut().take(900).skip(180).for_each(|value| *value = millimetres);
    };
    let emulator = Emulator::builder().model(urg_emulator::Model::Ust10lx).world(world).build();
    watched(emulator).await.layers.remove(0)
}

#[tokio::test(start_paused = true)]
async fn each_model_has_its_own_sector() {
    for (seen, ring) in [(3_500, "6 m"), (9_500, "10 m"), (29_000, "30 m")] {
        let mut model = Model::new(vec![ust(seen).await]);
        let alone = screen(&model, 120, 40);
        for part in [ring, "UST-10LX", "steps   0 to 1080", "-135.0° to 135.0°", " of 10 Hz"] {
            assert!(alone.contains(part), "{part:?} is missing in\n{alone}");
        }
        model.layers[0].pose = pose(0.0, 0.5, 0.0);
        let other = watched(ahead()).await.layers.remove(0);
        model.layers.push(Layer { pose: pose(0.0, -0.5, 0.0), ..other });
        let beside = screen(&model, 120, 40);
        assert!(beside.contains("▲1") && beside.contains(ring), "{beside}");
        // The rim of the URG, and the sector around it, stay at 4.2 m.
        assert_eq!(model.reach_of(&model.layers[1]), 4.2);
        assert!(model.reach_of(&model.layers[0]) >= f64::from(seen) / 1000.0);
    }
}

#[tokio::test(start_paused = true)]
async fn a_plain_terminal_gets_no_colours() {
    for model in [front_and_rear().await, shaded().await] {
        let terminal = terminal(&model, 80, 24, Palette::Plain);
        assert!(terminal.backend().buffer().content().iter().all(|cell| cell.fg == Color::Reset));
    }
}

/// Shows a weak wall around a sensor, with one strong point ahead.
async fn shaded() -> Model {
    let mut model = watched(ahead()).await;
    let scan = Scan::builder(Window::DETECTION, [2000; 682]);
    let intensities: Vec<_> = (44..726).map(|step| if step == 392 { 9000 } else { 100 }).collect();
    model.scanned(0, scan.intensities(intensities).build().unwrap());
    model
}

#[tokio::test(start_paused = true)]
async fn intensities_are_shades() {
    let cells = |model: &Model, index| cells_in(model, Color::Indexed(index)).len();
    let [weak, .., strong] = INTENSITIES.map(|colours| colours.indexed);
    let mut model = shaded().await;
    // The strong point is in sight, although later points fall into its cell.
    assert_eq!(cells(&model, strong), 1);
    assert!(cells(&model, weak) > 20);
    let seen = screen(&model, 80, 24);
    assert!(seen.contains("64 ████████████████ 16384"), "{seen}");
    press(&mut model, KeyCode::Char('?'));
    assert!(screen(&model, 80, 24).contains("coloured by intensity"));

    // Beside a sensor without intensities, each keeps its colour.
    let mut model = placed(&[("ust", pose(0.0, 3.0, 0.0)), ("urg", pose(0.0, -3.0, 0.0))]).await;
    model.layers[0].scan = shaded().await.layers.remove(0).scan;
    let [own, other, ..] = SENSORS.map(|colours| colours.indexed);
    let [own_weak, other_weak, ..] = WEAK_SENSORS;
    assert_eq!((cells(&model, own), cells(&model, other)), (1, 1));
    assert!(cells(&model, own_weak) > 20);
    assert_eq!((cells(&model, other_weak), cells(&model, weak)), (0, 0));
    press(&mut model, KeyCode::Char('?'));
    assert!(screen(&model, 80, 24).contains("colour, darker"));
    press(&mut model, KeyCode::Esc);
    assert!(cells(&model, own_weak) > 20);
    press(&mut model, KeyCode::Char(' '));
    assert_eq!(cells(&model, own_weak), 0, "a paused picture has no colours");
}

#[tokio::test(start_paused = true)]
async fn every_sensor_has_its_state_and_figures() {
    let mut model = front_and_rear().await;
    for (width, height) in [(80, 24), (200, 60)] {
        let screen = screen(&model, width, height);
        let parts = "1 front  /dev/ttyACM0  SOKUIKI Sensor URG-04LX H0713090|1 front  connected|\
                     2 rear  connected|10.0 Hz, 1 of 682|nearest 2.000 m at 0°|of front:|\
                     steps   44 to 725|x none  681|Tab  select";
        for part in parts.split('|') {
            assert!(screen.contains(part), "{part:?} is missing in\n{screen}");
        }
    }
    assert_eq!(press(&mut model, KeyCode::Tab), None);
    assert!(screen(&model, 80, 24).contains("of rear:"));
    press(&mut model, KeyCode::Tab);
    assert!(screen(&model, 80, 24).contains("of front:"));
    press(&mut model, KeyCode::BackTab);
    assert!(screen(&model, 80, 24).contains("of rear:"));
    press(&mut model, KeyCode::Char('1'));
    press(&mut model, KeyCode::Char('3'));
    assert!(screen(&model, 80, 24).contains("of front:"), "there is no third one");
}

#[tokio::test(start_paused = true)]
async fn keys_act_on_the_selected_sensor() {
    let mut model = front_and_rear().await;
    press(&mut model, KeyCode::Char('2'));
    assert!(matches!(press(&mut model, KeyCode::Char('w')), Some(Action::Watch(_))));
    assert_eq!(model.layers[0].window, Window::DETECTION);
    assert_ne!(model.layers[1].window, Window::DETECTION);
    press(&mut model, KeyCode::Char(' '));
    let other = tokio_scip::Scan::builder(Window::DETECTION, vec![0; 682]).build().unwrap();
    for number in 0..2 {
        model.scanned(number, tokio_scip::Scan::clone(&other));
        assert_eq!(model.layers[number].scan.as_ref().map(tokio_scip::Scan::sequence), Some(49));
    }
    press(&mut model, KeyCode::Char('?'));
    let help = screen(&model, 80, 24);
    for part in ["The picture, of all sensors:", "The selected sensor:", "select another sensor"] {
        assert!(help.contains(part), "{part:?} is missing in\n{help}");
    }
}

#[tokio::test(start_paused = true)]
async fn one_sensor_in_trouble_leaves_the_others_drawn() {
    let mut model = front_and_rear().await;
    let own = |model: &Model| cells_in(model, Palette::Coloured.sensor(0));
    let before = own(&model);
    unplug(&mut model, 1, 12).await;
    let lost = screen(&model, 80, 24);
    let trouble = ["2 rear  LOST for 12 s", " rear: ", "continues when the sensor is back"];
    for part in trouble.into_iter().chain(["1 front  connected"]) {
        assert!(lost.contains(part), "{part:?} is missing in\n{lost}");
    }
    assert_eq!(own(&model), before);
    assert_eq!(cells_in(&model, Palette::Coloured.sensor(1)), [], "it is of the past");
}

#[tokio::test(start_paused = true)]
async fn a_small_screen_shows_the_selected_sensor_and_trouble() {
    let many: Vec<_> = (0..14).map(|_| ("sensor", pose(0.2, 0.0, 0.0))).collect();
    let mut model = placed(&many).await;
    let small = screen(&model, 40, 12);
    assert!(small.contains("▲1") && small.contains("Tab  select"), "{small}");
    assert!(small.contains("1 of 682 points, 10.0 Hz"), "{small}");
    unplug(&mut model, 1, 7).await;
    let small = screen(&model, 40, 12);
    assert!(small.contains(" sensor: the link to the sensor is"), "{small}");
    // More sensors than the panel has rows for, at odd sizes.
    assert!(screen(&model, 80, 24).contains("14 sensor"));
    press(&mut model, KeyCode::BackTab);
    for (width, height) in [(30, 10), (47, 19), (64, 28), (132, 37), (199, 55)] {
        terminal(&model, width, height, Palette::Coloured);
    }
}

#[tokio::test(start_paused = true)]
async fn a_missing_sensor_is_named() {
    for (argument, expected) in [
        ("rear=/dev/ttyACM1", "rear: cannot open /dev/ttyACM1: "),
        ("/dev/ttyACM1", "cannot open /dev/ttyACM1: "),
    ] {
        let mut sensors = Vec::new();
        for port in ["front=/dev/ttyACM0", argument] {
            let sensor = Sensor::builder().connect(ahead()).await.unwrap();
            sensors.push((source(port), sensor));
        }
        let mut viewer = Viewer::from_sensors(sensors);
        let error = Error::open("/dev/ttyACM1", std::io::Error::other("no such port"));
        viewer.started((1, Err(error))).unwrap();
        let small = rows(&viewer.model, 40, 12)[..11].join("\n");
        assert!(small.contains(&format!("\n {expected}")), "{small}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_window_requested_during_opening_stays() {
    for is_open_first in [true, false] {
        let sensor = Sensor::builder().connect(ahead()).await.unwrap();
        let mut viewer = Viewer::from_sensors(vec![(source("/dev/ttyACM0"), sensor)]);
        let action = press(&mut viewer.model, KeyCode::Char('w'));
        viewer.act(action);
        let requested = viewer.model.layers[0].window;
        assert_ne!(requested, Window::DETECTION);
        let started = viewer.starts.join_next().await.unwrap().unwrap();
        let done = viewer.switches.join_next().await.unwrap().unwrap();
        if is_open_first {
            viewer.started(started).unwrap();
            viewer.switched(done);
        } else {
            viewer.switched(done);
            viewer.started(started).unwrap();
        }
        assert_eq!(viewer.model.layers[0].window, requested);
        let polled = viewer.sensor_mut(0).and_then(|(live, _)| live.scans.as_ref());
        assert_eq!(polled.map(ScanStream::window), Some(requested), "{is_open_first}");
    }
}
