//! What the sensor sees.

use std::time::Duration;

use tokio_scip::emulator::{Emulator, Room, STEPS, Values, World, WorldTime};

use super::ask;

/// The room at ten looks a second, as a sensor would ask for them.
fn looks(mut room: Room, count: usize) -> Vec<Values> {
    let (sender, receiver) = std::sync::mpsc::channel();
    let world = move |look: WorldTime, codes: &mut Values| {
        room.measure(look, codes);
        sender.send(*codes).unwrap();
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
fn a_room_is_mostly_distances_with_errors_where_a_sensor_has_them() {
    for seed in 0..20 {
        for codes in looks(Room::new(seed), 50) {
            assert!(codes[..44].iter().chain(&codes[726..]).all(|&code| code == 19));
            assert!(codes.iter().all(|&code| code < 4095));
            let window = &codes[44..=725];
            let distances = window.iter().filter(|&&code| code >= 20).count();
            assert!(distances > 682 * 75 / 100, "seed {seed}: {distances}");
            // In front is a wall, or something before it, or a doorway.
            assert!(window.iter().filter(|&&code| code >= 20).all(|&code| code > 100));
        }
    }
}

#[test]
fn a_room_has_every_kind_of_error_that_it_promises() {
    let mut seen = [0_u32; 20];
    for codes in (0..20).flat_map(|seed| looks(Room::new(seed), 20)) {
        for &code in codes[44..=725].iter().filter(|&&code| code < 20) {
            seen[usize::from(code)] += 1;
        }
    }
    for code in [0, 1, 2, 3, 4, 5, 6, 7, 9, 16] {
        assert!(seen[code] > 0, "no code {code}: {seen:?}");
    }
}

#[test]
fn points_next_to_each_other_are_on_the_same_surface_mostly() {
    let codes = looks(Room::new(1), 1)[0];
    let near = codes[44..=725].windows(2).filter(|pair| pair[0].abs_diff(pair[1]) < 60).count();
    assert!(near > 600, "{near}");
}

#[test]
fn people_move_and_walls_do_not() {
    let scans = looks(Room::new(3), 50);
    let (first, last) = (scans[0], scans[49]);
    let both = (44..=725).filter(|&step| first[step] >= 20 && last[step] >= 20);
    let moved = both.filter(|&step| first[step].abs_diff(last[step]) > 100).count();
    assert!((5..200).contains(&moved), "{moved}");
    // Nobody walks faster than a person: what a scan shows, the next one mostly
    // shows, too.
    for pair in scans.windows(2) {
        let jumps = (0..STEPS).filter(|&step| pair[0][step].abs_diff(pair[1][step]) > 100);
        assert!(jumps.count() < 60);
    }
}

#[test]
fn a_big_room_is_mostly_out_of_range() {
    let codes = looks(Room::sized(0, 16_000, 14_000, 0), 1)[0];
    let errors = codes[44..=725].iter().filter(|&&code| code < 20).count();
    assert!(errors > 682 / 2, "{errors}");
}

#[test]
fn the_same_seed_gives_the_same_scans() {
    assert!(looks(Room::new(5), 20) == looks(Room::new(5), 20));
    assert!(looks(Room::new(5), 1) != looks(Room::new(6), 1));
}

#[test]
fn a_room_is_the_same_on_every_machine() {
    let checksum = looks(Room::new(0), 10)
        .iter()
        .flatten()
        .fold(0_u64, |sum, &code| sum.wrapping_mul(0x0100_0000_01B3).wrapping_add(u64::from(code)));
    assert_eq!(
        checksum, 7576578781778081501,
        "the room has changed: recordings of it are not what they were"
    );
}

#[tokio::test(start_paused = true)]
async fn sensors_with_the_same_seed_say_the_same() {
    let mut heard = Vec::new();
    for seed in [8, 8, 9] {
        let mut link = Emulator::builder().seed(seed).build().link();
        let mut all = String::new();
        for _ in 0..10 {
            all += &ask(&mut link, "G04472501").await;
            tokio::time::sleep(Duration::from_millis(30)).await;
        }
        heard.push(all);
    }
    assert!(heard[0] == heard[1] && heard[0] != heard[2]);
}
