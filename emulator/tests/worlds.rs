//! The surroundings that the emulated sensor measures.

use std::time::Duration;

use tokio_scip::protocol::scip2::Parameters;
use tokio_scip::scan::Pose;
use tokio_scip::{Sensor, Window};
use urg_emulator::{
    Emulator, Fixed, Model, Path, Room, STEPS, Scene, Sparse, Values, Walk, World, WorldTime,
};

use super::ask;

/// Values of a URG-04LX.
type Sight = [u32; STEPS];

/// Returns the values of a world in a sensor's first revolutions, ten a second.
fn measured(mut room: impl World + 'static, count: usize) -> Vec<Sight> {
    let (sender, receiver) = std::sync::mpsc::channel();
    let world = move |time: WorldTime, codes: &mut Values| {
        room.measure(time, codes);
        sender.send(Sight::try_from(&*codes).unwrap()).unwrap();
    };
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
    runtime.unwrap().block_on(async {
        let mut link = Emulator::builder().world(world).build().link();
        for _ in 0..count {
            ask(&mut link, "G00000001").await;
        }
    });
    receiver.try_iter().collect()
}

#[test]
fn a_room_has_mostly_distances() {
    for seed in 0..20 {
        for codes in measured(Room::new(seed), 50) {
            assert!(codes[..44].iter().chain(&codes[726..]).all(|&code| code == 19));
            assert!(codes.iter().all(|&code| code < 4095));
            let window = &codes[44..=725];
            let distances = window.iter().filter(|&&code| code >= 20).count();
            assert!(distances > 682 * 75 / 100, "seed {seed}: {distances}");
            // In front is a wall, an object before it, or a doorway.
            assert!(window.iter().filter(|&&code| code >= 20).all(|&code| code > 100));
        }
    }
}

#[test]
fn a_room_has_every_kind_of_error_that_it_promises() {
    let mut seen = [0_u32; 20];
    for codes in (0..20).flat_map(|seed| measured(Room::new(seed), 20)) {
        for &code in codes[44..=725].iter().filter(|&&code| code < 20) {
            seen[code as usize] += 1;
        }
    }
    for code in [0, 1, 2, 3, 4, 5, 6, 7, 9, 16] {
        assert!(seen[code] > 0, "no code {code}: {seen:?}");
    }
}

#[test]
fn neighbouring_points_are_mostly_on_one_surface() {
    let codes = measured(Room::new(1), 1)[0];
    let near = codes[44..=725].windows(2).filter(|pair| pair[0].abs_diff(pair[1]) < 60).count();
    assert!(near > 600, "{near}");
}

#[test]
fn people_move_and_walls_do_not() {
    let scans = measured(Room::new(3), 50);
    let (first, last) = (scans[0], scans[49]);
    let both = (44..=725).filter(|&step| first[step] >= 20 && last[step] >= 20);
    let moved = both.filter(|&step| first[step].abs_diff(last[step]) > 100).count();
    assert!((5..200).contains(&moved), "{moved}");
    // Nobody moves faster than a person walks: most of what a scan shows is in the next
    // one, too.
    for pair in scans.windows(2) {
        let jumps = (0..STEPS).filter(|&step| pair[0][step].abs_diff(pair[1][step]) > 100);
        assert!(jumps.count() < 60);
    }
}

#[test]
fn a_big_room_is_mostly_out_of_range() {
    let codes = measured(Room::sized(0, 16_000, 14_000, 0), 1)[0];
    let errors = codes[44..=725].iter().filter(|&&code| code < 20).count();
    assert!(errors > 682 / 2, "{errors}");
}

#[test]
fn the_same_seed_gives_the_same_scans() {
    assert!(measured(Room::new(5), 20) == measured(Room::new(5), 20));
    assert!(measured(Room::new(5), 1) != measured(Room::new(6), 1));
}

#[test]
fn a_room_is_the_same_on_every_machine() {
    let checksum = |scans: Vec<Sight>| {
        scans.iter().flatten().fold(0_u64, |sum, &value| {
            sum.wrapping_mul(0x0100_0000_01B3).wrapping_add(u64::from(value))
        })
    };
    assert_eq!(
        [checksum(measured(Room::new(0), 10)), checksum(measured(Room::hard(0), 10))],
        [7576578781778081501, 9472447504408061105],
        "the rooms have changed: recordings made of them no longer match"
    );
}

/// The figures come from six scans captured indoors from a real URG-04LX.
#[test]
fn sensors_at_two_places_measure_the_same_walls() {
    let room = || Room::sized(3, 5000, 4400, 0);
    // Places are in the room's frame, in metres.
    let places = |values: &Sight, pose: Pose| -> Vec<(f64, f64)> {
        let measured = values.iter().enumerate().filter(|(_, value)| **value >= 20);
        let place = |(step, &value): (usize, &u32)| {
            let angle = (step as f64 - 384.0) * std::f64::consts::TAU / 1024.0;
            let angle = pose.heading + if pose.upside_down { -angle } else { angle };
            let range = f64::from(value) / 1000.0;
            (pose.x + range * angle.cos(), pose.y + range * angle.sin())
        };
        measured.map(place).collect()
    };
    let ours = places(&measured(room(), 1)[0], Pose::default());
    let share_that_meets = |theirs: Vec<(f64, f64)>| {
        let near = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).hypot(a.1 - b.1) < 0.06;
        let meets = theirs.iter().filter(|place| ours.iter().any(|ours| near(*ours, **place)));
        meets.count() as f64 / theirs.len() as f64
    };
    for upside_down in [false, true] {
        let pose = Pose { x: 0.5, y: -0.3, heading: 90f64.to_radians(), upside_down };
        let moved = measured(room().seen_from(pose), 1)[0];
        // The rest is hidden from the other sensor, or out of its range.
        assert!(share_that_meets(places(&moved, pose)) > 0.5);
        let wrong = Pose { upside_down: !upside_down, ..pose };
        assert!(share_that_meets(places(&moved, wrong)) < 0.3);
        assert!(share_that_meets(places(&measured(room(), 1)[0], pose)) < 0.2);
    }
    let outside = measured(room().seen_from(Pose { x: 9.0, ..Pose::default() }), 1)[0];
    assert!(outside.iter().all(|value| *value < 20));
}

/// Expectations are by hand: a sensor under a ceiling calls left what is right of its front.
#[test]
fn an_upside_down_sensor_counts_its_steps_clockwise() {
    let pillar = |at| Scene::new(0).without_noise().disc(at, 0.1);
    for (upside_down, heading, at, step) in [
        (false, 0.0, (0.0, 1.0), 640), // 90 degrees to the left
        (true, 0.0, (0.0, 1.0), 128),
        (true, 0.0, (1.0, 0.0), 384),
        (true, 90.0, (1.0, 0.0), 640),
        (true, 90.0, (-1.0, 0.0), 128),
        (true, 180.0, (0.0, 1.0), 640),
    ] {
        let pose = Pose { heading: f64::to_radians(heading), upside_down, ..Pose::default() };
        let path = Path::new([(Duration::ZERO, pose)]);
        let values = measured(pillar(at).sensor_on(path), 1)[0];
        let seen: Vec<usize> = (44..=725).filter(|&step| values[step] >= 20).collect();
        assert_eq!((seen[0] + seen[seen.len() - 1]) / 2, step, "{pose:?} {at:?}");
        assert_eq!(values[step], 900);
    }
}

#[test]
fn a_hard_room_misses_as_many_points() {
    let mut total = 0;
    for seed in 0..20 {
        let (mut counts, mut points) = ([0_u32; 20], 0);
        let (mut nearest, mut farthest) = (u32::MAX, 0);
        for values in measured(Room::hard(seed), 20) {
            for &value in &values[44..=725] {
                points += 1;
                match counts.get_mut(value as usize) {
                    Some(count) => *count += 1,
                    None => (nearest, farthest) = (nearest.min(value), farthest.max(value)),
                }
            }
        }
        let missing = counts.iter().sum::<u32>();
        let usual = counts[0] + counts[6] + counts[16] + counts[7];
        assert!((45..=65).contains(&(100 * missing / points)), "seed {seed}: {counts:?} {points}");
        assert!(usual * 100 > missing * 85, "seed {seed}: {counts:?}");
        assert!(nearest < 400 && farthest > 3700, "seed {seed}: {nearest} {farthest}");
        total += 100 * missing / points;
    }
    assert!((52..=58).contains(&(total / 20)), "{total}");
}

#[test]
fn a_scene_has_its_parts_in_place() {
    let scene = Scene::new(0)
        .without_noise()
        .wall((2.0, -1.0), (2.0, 1.0))
        .rectangle((-0.5, 1.5), (0.5, 2.5))
        .disc((0.0, -3.0), 0.5);
    let values = measured(scene, 1)[0];
    let degrees = |angle: f64| values[(384.0 + angle * 1024.0 / 360.0).round() as usize];
    assert_eq!(degrees(0.0), 2000);
    // The wall ends at 26.6 degrees: a step before its end, and a step past it.
    assert!(degrees(26.3).abs_diff(2231) < 5, "{}", degrees(26.3));
    assert_eq!(degrees(27.0), 0, "nothing is there");
    assert_eq!((degrees(90.0), degrees(-90.0)), (1500, 2500));
    assert!(degrees(-89.0) < 2510 && degrees(-100.0) == 0);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_of_any_resolution_sees_walls_in_place() {
    for (resolution, last) in [(1024, 768), (1440, 1080), (2880, 2160)] {
        let numbers = format!("ARES:{resolution} AMAX:{last} AFRT:{}", last / 2);
        let told = format!("MODL:UST-10LX DMIN:21 DMAX:30000 AMIN:0 SCAN:2400 {numbers}");
        let pairs = told.split(' ').filter_map(|pair| pair.split_once(':'));
        let parameters = Parameters::from_pairs(pairs).unwrap();
        let mut room = Scene::new(0).without_noise().rectangle((-2.0, -1.5), (3.0, 1.0));
        let world = move |time: WorldTime, values: &mut Values| {
            assert_eq!(time.at_step(last + 1), time.at);
            assert_eq!(time.at - time.at_step(last / 2 + 1), time.period * 3 / 8);
            room.measure(time, values);
        };
        let emulator =
            Emulator::builder().model(Model::Ust10lx).parameters(parameters).world(world);
        let sensor = Sensor::builder().connect(emulator.build()).await.unwrap();
        let scan = sensor.scan(Window::DETECTION).await.unwrap();
        assert_eq!(scan.points().count(), last + 1);
        for point in scan.points() {
            let [x, y] = [point.x, point.y];
            let away = [x + 2.0, x - 3.0, y + 1.5, y - 1.0].map(f32::abs);
            assert!(away.into_iter().any(|away| away < 0.002), "{resolution}: {x} {y}");
        }
    }
}

#[test]
fn a_person_walks_as_described() {
    let walk = Walk::new((1.0, -1.0), (1.0, 1.0)).starting_at(Duration::from_secs(2)).speed(1.0);
    assert_eq!(walk.duration(), Duration::from_secs(2));
    let scans = measured(Scene::new(7).person(walk), 60);
    let place = |values: &Sight| {
        let steps: Vec<usize> = (44..=725).filter(|&step| values[step] >= 20).collect();
        (!steps.is_empty()).then(|| steps.iter().sum::<usize>() / steps.len())
    };
    let places: Vec<_> = scans.iter().map(place).collect();
    // Scan n shows the revolution that ended n * 0.1 s after power-up.
    assert!(places[..18].iter().chain(&places[41..]).all(Option::is_none), "{places:?}");
    let walked: Vec<usize> = places[20..39].iter().map(|place| place.unwrap()).collect();
    assert!(walked.windows(2).all(|pair| pair[0] < pair[1] + 6), "from right to left: {walked:?}");
    assert!(walked[0] < 290 && walked[18] > 480, "{walked:?}");
}

#[test]
fn a_disc_goes_back_and_forth() {
    let walk = Walk::new((1.0, 0.0), (2.0, 0.0)).speed(1.0).back_and_forth();
    let scans = measured(Scene::new(0).without_noise().moving_disc(0.2, walk), 45);
    let ahead: Vec<u32> = scans.iter().map(|values| values[384]).collect();
    let turns: Vec<usize> = (1..44)
        .filter(|&scan| (ahead[scan - 1] < ahead[scan]) != (ahead[scan] < ahead[scan + 1]))
        .collect();
    // The front is measured half a revolution before its end, and 50 mm before the turn.
    assert!(ahead.iter().max().unwrap().abs_diff(1750) <= 1, "{ahead:?}");
    assert!(turns.windows(2).all(|pair| pair[1] - pair[0] == 10), "{turns:?}");
}

#[test]
fn a_sparse_world_omits_the_requested_share() {
    for (share, from, to) in
        [(0.0, 0, 0), (0.3, 28, 40), (0.5, 47, 60), (0.8, 77, 90), (1.0, 100, 100)]
    {
        let scans = measured(Sparse::new(Fixed::filled(1234), share, 3), 20);
        let values: Vec<u32> = scans.iter().flat_map(|values| values[44..=725].to_vec()).collect();
        let missing = values.iter().filter(|&&value| value < 20).count() * 100 / values.len();
        assert!((from..=to).contains(&missing), "{share}: {missing} %");
        assert!(values.iter().all(|value| [0, 6, 16, 7, 1234].contains(value)));
        // Missing points stay where they are, except at the ends of a run.
        let changed = scans
            .windows(2)
            .map(|pair| (0..STEPS).filter(|&step| pair[0][step] != pair[1][step]).count());
        assert!(changed.max() < Some(120));
    }
}

#[tokio::test(start_paused = true)]
async fn sensors_with_the_same_seed_send_the_same_bytes() {
    let mut received = Vec::new();
    for seed in [8, 8, 9] {
        let mut link = Emulator::builder().seed(seed).build().link();
        let mut all = String::new();
        for _ in 0..10 {
            all += &ask(&mut link, "G04472501").await;
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
        received.push(all);
    }
    assert!(received[0] == received[1] && received[0] != received[2]);
}

#[tokio::test(start_paused = true)]
async fn a_moving_sensor_measures_each_ray_in_time() {
    // The sensor moves at 1 m/s towards a wall, turned to the left.
    let pose = |x| Pose { x, y: 0.3, heading: 0.2, upside_down: false };
    let path = Path::new([(Duration::ZERO, pose(0.0)), (Duration::from_secs(2), pose(2.0))]);
    let wall = Scene::new(0).without_noise().wall((3.0, -5.0), (3.0, 5.0));
    let emulator = Emulator::builder().world(wall.sensor_on(path.clone())).build();
    let mut link = emulator.link();
    let (mut values, mut last) = (Vec::new(), None);
    for _ in 0..30 {
        for step in [200_u16, 384, 500] {
            let reply = ask(&mut link, &format!("G{step:03}{step:03}01")).await;
            let time = emulator.sent_scans().last().unwrap().time;
            let pose = path.pose(time.at_step(step.into()));
            let angle = (f64::from(step) - 384.0) * std::f64::consts::TAU / 1024.0 + pose.heading;
            let distance = (3.0 - pose.x) / angle.cos() * 1000.0;
            let [.., high, low, b'\n', b'\n'] = reply.as_bytes() else { panic!("{reply:?}") };
            let value = f64::from(u32::from(high - b'0') << 6 | u32::from(low - b'0'));
            if distance < 4000.0 {
                assert!((value - distance).abs() <= 1.0, "{value} {distance}");
                values.push(value);
            }
            assert_eq!(time.period, Duration::from_millis(100));
            last = Some(pose);
        }
    }
    assert!(values.len() > 50 && last == Some(pose(2.0)), "{last:?}");
}

#[test]
fn a_walker_is_where_its_walk_says() {
    let walk = Walk::new((1.0, -1.0), (1.0, 1.0)).speed(0.5).starting_at(Duration::from_secs(1));
    assert_eq!(walk.position(Duration::from_millis(999)), None);
    assert_eq!(walk.position(Duration::from_secs(2)), Some((1.0, -0.5)));
    assert_eq!(walk.position(Duration::from_secs(5)), Some((1.0, 1.0)));
    assert_eq!(walk.position(Duration::from_millis(5001)), None);
}
