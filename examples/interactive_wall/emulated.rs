//! A wall in software, 2 m wide: somebody touches the corners of the picture, and from then on
//! moves both hands back and forth.

use std::time::Duration;

use urg_emulator::{Emulator, Scene, Walk};

pub(super) fn sensor() -> Emulator {
    let wall = Scene::new(1).rectangle((-0.5, -1.8), (3.2, 1.8));
    let hand = |scene: Scene, walk, start| {
        scene.moving_disc(0.04, Walk::starting_at(walk, Duration::from_secs(start)))
    };
    // Each hand moves by 2 mm in 2 s, so it touches one place.
    let touch = |(x, y)| Walk::new((x, y), (x + 0.002, y)).speed(0.001);
    let corners = [((0.4, 0.6), 2), ((2.4, 0.6), 5), ((2.4, -0.6), 8), ((0.4, -0.6), 11)];
    let wall = corners.into_iter().fold(wall, |wall, (at, start)| hand(wall, touch(at), start));
    let wave = |y| Walk::new((0.6, y), (2.2, y)).speed(0.5).back_and_forth();
    Emulator::builder().world(hand(hand(wall, wave(0.3), 14), wave(-0.24), 15)).usb().build()
}
