//! The interactive wall, on the paused clock: what it sends, beside where emulated hands are.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};

use tokio::net::UdpSocket;
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_scip::{Rate, Sensor, Window};
use urg_emulator::{Emulator, Scene, Values, Walk, World, WorldTime};

use crate::common::{limit::limit, ms, random::seeds};

use super::programs::interactive_wall::{self, Picture, Spot};
use super::tuio::{Cursor, Frame};

/// The sensor lies 0.4 m left of the middle of the picture's left edge, turned by this.
const TURN: f64 = 0.2;
/// Width and height of the picture, in metres.
const SIZE: Spot = (2.0, 1.2);
const CORNERS: [Spot; 4] = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];

/// Returns where a place of the picture is in the sensor's frame.
fn spot((u, v): Spot) -> Spot {
    let (x, y) = (0.4 + SIZE.0 * u, SIZE.1 * (0.5 - v));
    (x * TURN.cos() - y * TURN.sin(), x * TURN.sin() + y * TURN.cos())
}

/// Returns the way of a hand between two places, from a time in milliseconds.
fn walk(from: Spot, to: Spot, start: u64, speed: f64) -> Walk {
    Walk::new(spot(from), spot(to)).starting_at(ms(start)).speed(speed)
}

/// Returns a hand that touches one place: it moves by 2 mm in 2 s.
fn touch((u, v): Spot, start: u64) -> Walk {
    walk((u, v), (u + 0.001, v), start, 0.001)
}

/// Returns a wall with hands 8 cm wide.
fn scene<'a>(seed: u64, hands: impl IntoIterator<Item = &'a Walk>) -> Scene {
    let wall = Scene::new(seed).rectangle((-0.5, -1.8), (3.2, 1.8));
    hands.into_iter().fold(wall, |wall, &hand| wall.moving_disc(0.04, hand))
}

/// The running example, and when the sensor last measured.
struct Wall {
    socket: UdpSocket,
    emulator: Emulator,
    measured: Arc<Mutex<Option<WorldTime>>>,
    task: JoinHandle<interactive_wall::Result<()>>,
}

impl Wall {
    async fn start(mut scene: Scene, corners: Option<[Spot; 4]>) -> Self {
        limit();
        let measured = Arc::new(Mutex::new(None));
        let last = Arc::clone(&measured);
        let world = move |time: WorldTime, values: &mut Values| {
            scene.measure(time, values);
            *last.lock().unwrap() = Some(time);
        };
        let emulator = Emulator::builder().world(world).usb().build();
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let sender = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        sender.connect(socket.local_addr().unwrap()).await.unwrap();
        let task = tokio::spawn(interactive_wall::run(scans, corners, sender));
        Self { socket, emulator, measured, task }
    }

    async fn next(&self) -> Frame {
        let mut packet = [0; 2048];
        let received = timeout(ms(60_000), self.socket.recv(&mut packet)).await;
        let received = received.expect("no bundle").unwrap();
        Frame::decode(&packet[..received], "interactive_wall@127.0.0.1")
    }

    /// Returns the first bundle with this number of cursors.
    async fn next_with(&self, count: usize) -> Frame {
        loop {
            let frame = self.next().await;
            if frame.cursors.len() == count {
                return frame;
            }
        }
    }

    /// Returns how far a cursor is from a hand, in metres, if the hand was there when the sensor
    /// measured in the cursor's direction.
    fn distance(&self, cursor: &Cursor, walk: &Walk) -> Option<f64> {
        let (x, y) = spot(cursor.place);
        let step = 384.0 + y.atan2(x) / TAU * 1024.0;
        let measured = (*self.measured.lock().unwrap())?;
        let truth = walk.position(measured.at_step(step as usize))?;
        Some((truth.0 - x).hypot(truth.1 - y))
    }
}

#[tokio::test(start_paused = true)]
async fn hands_are_cursors_where_they_are() {
    for seed in seeds("SCIP_WALL", 3) {
        let touches = [3000, 6000, 9000, 12_000];
        let touches: Vec<Walk> =
            CORNERS.into_iter().zip(touches).map(|(at, start)| touch(at, start)).collect();
        // Two pass each other, one is fast, and two come close to each other.
        let ways = [
            ((0.1, 0.3), (0.9, 0.3), 16_000, 0.8),
            ((0.9, 0.75), (0.1, 0.75), 16_500, 0.8),
            ((0.3, 0.1), (0.7, 0.9), 20_000, 1.5),
            ((0.2, 0.4), (0.8, 0.4), 22_000, 0.6),
            ((0.2, 0.6), (0.8, 0.6), 22_000, 0.6),
            // One right after the other: nearer to where that was than to where it was.
            ((0.5, 0.1), (0.5, 0.9), 26_000, 1.5),
            ((0.5, 0.1), (0.5, 0.9), 26_190, 1.5),
        ];
        let walks = ways.map(|(from, to, start, speed)| walk(from, to, start, speed));
        let outside = walk((0.2, -0.2), (0.8, -0.2), 17_000, 0.4);
        let hands = touches.iter().chain(&walks).chain([&outside]);
        let wall = Wall::start(scene(seed, hands), None).await;
        // The hand at the last corner may still be there, seen in some scans.
        let mut last = wall.next().await;
        while wall.measured.lock().unwrap().is_some_and(|time| time.at < ms(15_000)) {
            last = wall.next().await;
        }
        let (mut ids, mut worst) = (BTreeMap::new(), 0f64);
        let mut seen = walks.map(|_| Vec::new());
        while !wall.measured.lock().unwrap().is_some_and(|time| time.at > ms(28_000)) {
            let next = wall.next().await;
            assert_eq!(next.number, last.number + 1);
            for (id, cursor) in &next.cursors {
                let before = last.cursors.get(id);
                // One that the scan does not show stays where it was.
                if before.is_some_and(|before| before.place == cursor.place) {
                    continue;
                }
                let distances = walks.iter().map(|walk| wall.distance(cursor, walk)).enumerate();
                let known = distances.filter_map(|(walk, distance)| Some((distance?, walk)));
                let (distance, walk) = known.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
                worst = worst.max(distance);
                assert_eq!(*ids.entry(*id).or_insert(walk), walk, "{id} jumps to another hand");
                seen[walk].push(*cursor);
                let speed = before.map_or(cursor.speed(), Cursor::speed);
                let change = (cursor.speed() - speed) / 0.1;
                assert!(
                    (cursor.acceleration - change).abs() < 0.2 + 0.1 * change.abs(),
                    "{cursor:?}"
                );
            }
            last = next;
        }
        assert!(last.cursors.is_empty(), "{last:?}");
        assert_eq!(ids.len(), walks.len(), "{ids:?}");
        println!("{seed}: at most {:.1} mm off", worst * 1000.0);
        assert!(worst < 0.02, "{worst}");
        for ((way, walk), seen) in ways.into_iter().zip(walks).zip(seen) {
            let seconds = walk.duration().as_secs_f64();
            assert!(seen.len() as f64 + 2.0 > 10.0 * seconds, "{} in {seconds} s", seen.len());
            // A new cursor stands still.
            let (first, rest) = seen.split_first().unwrap();
            assert!(first.speed() == 0.0 && first.acceleration == 0.0, "{first:?}");
            let mean =
                |of: fn(&Cursor) -> f64| rest.iter().map(of).sum::<f64>() / rest.len() as f64;
            let ((u0, v0), (u1, v1), ..) = way;
            let (du, dv) = ((u1 - u0) / seconds, (v1 - v0) / seconds);
            let off = (mean(|c| c.velocity.0) - du).hypot(mean(|c| c.velocity.1) - dv);
            // By the mean, only where it began and ended counts, on a wall of this height.
            let ((left, top), (right, bottom)) = (spot((0.0, 0.0)), spot((0.0, 1.0)));
            let height = (left - right).hypot(top - bottom);
            let bound = 2.0 * worst / height / (rest.len() as f64 / 10.0);
            assert!(off < bound, "{off} of {du}, {dv}: at most {bound}");
        }
        assert!(!wall.task.is_finished());
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_sensor_leaves_no_cursor() {
    let hand = walk((0.2, 0.5), (0.8, 0.5), 2000, 0.1).back_and_forth();
    let wall = Wall::start(scene(1, [&hand]), Some(CORNERS.map(spot))).await;
    let first = wall.next_with(1).await;
    wall.emulator.unplug();
    let lost = wall.next_with(0).await;
    assert!(lost.number < first.number + 5, "{first:?} {lost:?}");
    wall.emulator.plug_in();
    let again = wall.next_with(1).await;
    assert_ne!(first.cursors.keys().next(), again.cursors.keys().next());
}

/// The perspective of a projector that hangs askew.
fn askew((u, v): Spot) -> Spot {
    let scale = 0.4 * u + 0.2 * v + 1.0;
    ((2.0 * u + 0.3 * v + 0.5) / scale, (0.8 - 0.2 * u - 1.5 * v) / scale)
}

#[test]
fn a_picture_may_be_askew_or_mirrored() {
    for mirror in [1.0, -1.0] {
        let seen = |at| (askew(at).0, mirror * askew(at).1);
        let picture = Picture::new(CORNERS.map(seen)).unwrap();
        for (u, v) in
            (0..100).map(|n| (f64::from(n % 10) / 9.01 + 0.0005, f64::from(n / 10) / 9.01 + 0.0005))
        {
            let (x, y) = picture.place(seen((u, v))).unwrap();
            assert!((x - u).hypot(y - v) < 1e-9, "{u} {v}: {x} {y}");
        }
        for outside in [(-0.01, 0.5), (1.01, 0.5), (0.5, -0.01), (0.5, 1.01)] {
            assert_eq!(picture.place(seen(outside)), None);
        }
    }
}

#[test]
fn corners_out_of_order_are_refused() {
    let [a, b, c, d] = CORNERS;
    let nan = (f64::NAN, 0.0);
    for corners in
        [[a, c, b, d], [a, a, c, d], [a, b, (0.5, 0.5), d], [a, b, c, (0.2, 0.1)], [nan, b, c, d]]
    {
        let refused = Picture::new(corners).err().unwrap().to_string();
        assert!(refused.contains("expected four corners, in the order top left"), "{refused}");
    }
}
