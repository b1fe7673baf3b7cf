//! What examples promise, on the paused clock, where hours and faults cost little.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::{Notify, mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};
use tokio_scip::scan::Pose;
use tokio_scip::{Rate, Sensor, State, Window};
use urg_emulator::{
    Emulator, Fault, Faults, Fixed, Model, Room, Scene, Sparse, Values, Walk, World, WorldTime,
};

use crate::common::{limit::limit, ms, random::seeds};

use super::programs::merged::{self, Mounted};
#[cfg(unix)]
use super::programs::own_transport;
use super::programs::safety_stop::{self, Fields, Motion, TERMS, Terms};
use super::programs::{count_people, fleet, graceful_shutdown, odometry};

/// A room in which an obstacle appears: the smallest that must be seen, at the limit of the
/// clearance, 20 degrees to the left.
struct Appearing {
    room: Box<dyn World>,
    blocked: Box<dyn World>,
    is_blocked: Arc<AtomicBool>,
}

impl World for Appearing {
    fn measure(&mut self, time: WorldTime, values: &mut Values) {
        let blocked = self.is_blocked.load(Ordering::Relaxed);
        let world = if blocked { &mut self.blocked } else { &mut self.room };
        world.measure(time, values);
    }
}

/// Figures of a run of the safety stop.
#[derive(Debug, Default)]
struct PromiseRun {
    /// Longest time from an obstacle to the stop.
    reaction: Duration,
    /// Age of the oldest good scan that permitted to move.
    age: Duration,
    /// Share of the time during which the field was clear and the vehicle could move.
    clear: f64,
}

/// Starts the guard of a sensor.
async fn guarded(
    sensor: &Sensor,
    interlock: Option<Arc<Notify>>,
) -> (JoinHandle<()>, watch::Receiver<Motion>) {
    let fields = Fields::new(sensor.geometry().await.unwrap()).unwrap();
    let scans = fields.scans(sensor).await.unwrap();
    let (output, motion) = watch::channel(Motion::Stop);
    (tokio::spawn(safety_stop::guard(fields, scans, output, interlock)), motion)
}

/// Runs the safety stop for `obstacles` obstacles, two seconds each, with three seconds
/// between them, and looks at its output every 5 ms.
async fn run(
    world: Appearing,
    faults: Faults,
    is_blocked: &AtomicBool,
    obstacles: u32,
) -> PromiseRun {
    limit();
    let emulator = Emulator::builder().world(world).build();
    fastrand::seed(7);
    let sensor = safety_stop::settings().connect(emulator.clone()).await.unwrap();
    let (guard, motion) = guarded(&sensor, None).await;
    emulator.set_faults(faults);
    let mut run = PromiseRun::default();
    let (mut driving, mut total) = (0, 0);
    for _ in 0..obstacles {
        for (blocked, length) in [(false, 3000), (true, 2000)] {
            is_blocked.store(blocked, Ordering::Relaxed);
            let start = Instant::now();
            while start.elapsed() < ms(length) {
                sleep(ms(5)).await;
                let moves = *motion.borrow() != Motion::Stop;
                if moves {
                    run.age = run.age.max(sensor.freshness().age().unwrap());
                }
                if moves && blocked {
                    run.reaction = run.reaction.max(start.elapsed());
                }
                // From then on it would move without faults.
                if !blocked && start.elapsed() > TERMS.response() + safety_stop::RESTART {
                    (driving, total) = (driving + u32::from(moves), total + 1);
                }
            }
        }
    }
    run.clear = f64::from(driving) / f64::from(total);
    drop(sensor);
    guard.abort();
    assert!(guard.await.is_err());
    assert_eq!(*motion.borrow(), Motion::Stop, "a guard that ends stops the vehicle");
    run
}

/// Returns an obstacle of the smallest width at `distance`, facing the sensor.
fn obstacle(distance: f64) -> Scene {
    let width = safety_stop::WIDTH;
    let end = |left: f64| {
        let angle = 20f64.to_radians();
        (distance * angle.cos() - left * angle.sin(), distance * angle.sin() + left * angle.cos())
    };
    Scene::new(1).rectangle((-2.0, -2.0), (3.0, 2.0)).wall(end(-width / 2.0), end(width / 2.0))
}

fn appearing(room: impl World + 'static) -> (Appearing, Arc<AtomicBool>) {
    let is_blocked = Arc::new(AtomicBool::new(false));
    // Its distances are as sparse as in the hard room.
    let blocked = Box::new(Sparse::new(obstacle(TERMS.distance() - 0.03), 0.44, 3));
    let world = Appearing { room: Box::new(room), blocked, is_blocked: Arc::clone(&is_blocked) };
    (world, is_blocked)
}

#[tokio::test(start_paused = true)]
async fn the_vehicle_stops_in_time_with_every_fault() {
    let faults = [
        Fault::CommandLost,
        Fault::Lost,
        Fault::Late(ms(80)),
        Fault::Late(ms(700)),
        Fault::Doubled,
        Fault::Drop(100..101),
        Fault::Insert(100, b"0".to_vec()),
        Fault::Repeat(20..85),
        Fault::Cut(200),
        Fault::Damaged,
        Fault::Merged,
        Fault::Garbage(b"x\n\n".to_vec()),
        Fault::Noise(50),
        Fault::Pause(100, ms(400)),
        Fault::Trickle(ms(1)),
        Fault::CrLf,
        Fault::Status(b'7'),
        Fault::Reset(100),
        Fault::HangUp(100),
        Fault::Endless(b"x".to_vec()),
    ];
    for (share, fault) in [(0.0, Fault::Lost)].into_iter().chain(faults.map(|fault| (0.2, fault))) {
        let (world, is_blocked) = appearing(Fixed::filled(3000));
        let faults = Faults::none().rate(share, fault.clone());
        let run = run(world, faults, &is_blocked, 4).await;
        println!("{share} {fault:?}: {run:?}");
        assert!(run.reaction <= TERMS.response(), "{fault:?}: {run:?}");
        assert!(run.age <= TERMS.limit + ms(5), "{fault:?}: {run:?}");
        assert!(share > 0.0 || run.clear == 1.0, "{run:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn no_obstacle_is_missed_in_the_hard_room() {
    let (world, is_blocked) = appearing(Room::hard(1));
    let run = run(world, Faults::none().rate(0.01, Fault::Lost), &is_blocked, 60).await;
    println!("{run:?}");
    assert!(run.reaction <= TERMS.response(), "{run:?}");
    assert!(run.clear >= 0.99, "{run:?}");
}

#[test]
fn the_protective_field_follows_from_its_terms() {
    // A person who walks towards a machine that stops 300 ms after the output.
    let terms = Terms { approach: 1.6, braking: ms(300), supplement: 0.85, ..TERMS };
    assert!((terms.distance() - (1.6 * (0.1 + 0.05 + 0.5 + 0.3) + 0.85)).abs() < 1e-9);
    assert!((TERMS.distance() - 0.6).abs() < 1e-9);
}

/// Returns a room with an obstacle in the revolutions for which `is_there` returns true.
fn sensor_with(
    model: Model,
    distance: f64,
    is_there: impl Fn(u64) -> bool + Send + 'static,
) -> Emulator {
    limit();
    let (mut blocked, mut clear) = (obstacle(distance), Fixed::filled(3000));
    let world = move |time: WorldTime, values: &mut Values| match is_there(time.revolution) {
        true => blocked.measure(time, values),
        false => clear.measure(time, values),
    };
    Emulator::builder().model(model).world(world).usb().build()
}

async fn waits_for(motion: &mut watch::Receiver<Motion>, wanted: Motion) {
    let outcome = timeout(ms(20_000), motion.wait_for(|motion| *motion == wanted)).await;
    outcome.expect("it does not get there").unwrap();
}

#[tokio::test(start_paused = true)]
async fn two_of_three_scans_stop_the_vehicle() {
    for (pattern, stops) in [([3, 6, 9], false), ([3, 5, 9], true), ([3, 4, 9], true)] {
        let is_there = move |revolution| revolution > 50 && pattern.contains(&(revolution % 10));
        let emulator = sensor_with(Model::default(), 0.5, is_there);
        let sensor = safety_stop::settings().connect(emulator).await.unwrap();
        let (_guard, mut motion) = guarded(&sensor, None).await;
        waits_for(&mut motion, Motion::Drive).await;
        let stopped = timeout(ms(20_000), motion.wait_for(|motion| *motion == Motion::Stop)).await;
        assert_eq!(stopped.is_ok(), stops, "{pattern:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn an_obstacle_in_the_warning_field_slows_the_vehicle() {
    for model in [Model::Urg04lx, Model::Urg04lxUg01, Model::Utm30lx, Model::Ust10lx] {
        let distance = 1.5 * TERMS.distance();
        let emulator = sensor_with(model, distance, |revolution| revolution > 150);
        let sensor = safety_stop::settings().connect(emulator).await.unwrap();
        let (_guard, mut motion) = guarded(&sensor, None).await;
        waits_for(&mut motion, Motion::Drive).await;
        waits_for(&mut motion, Motion::Slow).await;
        sleep(ms(5000)).await;
        assert_eq!(*motion.borrow(), Motion::Slow, "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_vehicle_restarts_after_a_delay_and_a_reset() {
    let is_blocked = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&is_blocked);
    let emulator = sensor_with(Model::default(), 0.5, move |_| seen.load(Ordering::Relaxed));
    let sensor = safety_stop::settings().connect(emulator).await.unwrap();
    let reset = Arc::new(Notify::new());
    let (_first, mut automatic) = guarded(&sensor, None).await;
    let (_second, mut locked) = guarded(&sensor, Some(Arc::clone(&reset))).await;
    for _ in 0..2 {
        let clear = Instant::now();
        waits_for(&mut automatic, Motion::Drive).await;
        assert!(clear.elapsed() >= safety_stop::RESTART, "{:?}", clear.elapsed());
        sleep(ms(5000)).await;
        assert_eq!(*locked.borrow(), Motion::Stop);
        reset.notify_one();
        waits_for(&mut locked, Motion::Drive).await;
        is_blocked.store(true, Ordering::Relaxed);
        waits_for(&mut automatic, Motion::Stop).await;
        waits_for(&mut locked, Motion::Stop).await;
        // Does not count: there is an obstacle in the field.
        reset.notify_one();
        sleep(ms(1000)).await;
        is_blocked.store(false, Ordering::Relaxed);
    }
}

/// Returns a function that waits for the next report about the people at a door.
fn count(emulator: Emulator) -> impl AsyncFnMut() -> Result<usize, String> {
    limit();
    let (sensor, driver) = Sensor::builder().wait_for_sensor(true).build(emulator);
    tokio::spawn(driver);
    let (reports, mut counts) = mpsc::channel(16);
    tokio::spawn(count_people::watch("door".to_owned(), sensor, reports));
    async move || timeout(ms(60_000), counts.recv()).await.unwrap().unwrap().1
}

#[tokio::test(start_paused = true)]
async fn up_to_three_walkers_are_counted() {
    for seed in seeds("SCIP_WALKERS", 3) {
        // They walk at different distances, and never one in front of the other.
        let walk = |from, to, start, speed| Walk::new(from, to).starting_at(ms(start)).speed(speed);
        let walks = [
            walk((0.8, -1.7), (2.2, -1.7), 3000, 0.10), // until 17 s
            walk((2.8, -0.7), (1.6, 0.7), 6000, 0.25),  // until 13.4 s
            walk((1.9, 1.7), (0.7, 1.7), 9000, 0.60),   // until 11 s
        ];
        let room = Scene::new(seed).rectangle((-2.0, -2.5), (3.5, 2.5));
        let scene = walks.into_iter().fold(room, Scene::person);
        let mut next = count(Emulator::builder().world(scene).build());
        assert_eq!(next().await, Err("learning the empty doorway".to_owned()));
        for people in [0, 1, 2, 3, 2, 1, 0] {
            assert_eq!(next().await, Ok(people), "{seed}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_door_without_its_sensor_has_no_count() {
    let someone = Arc::new(AtomicBool::default());
    let seen = Arc::clone(&someone);
    let emulator = Emulator::builder()
        .world(move |_: WorldTime, values: &mut Values| {
            values.fill(3000);
            if seen.load(Ordering::Relaxed) {
                values[300..330].fill(1200);
            }
        })
        .build();
    emulator.unplug();
    let mut next = count(emulator.clone());
    let absent = async |unknown: Result<usize, String>| {
        let reason = unknown.unwrap_err();
        assert!(reason.contains("no port"), "{reason}");
    };
    absent(next().await).await;
    for _ in 0..2 {
        emulator.plug_in();
        assert_eq!(next().await, Ok(0));
        someone.store(true, Ordering::Relaxed);
        assert_eq!(next().await, Ok(1));
        someone.store(false, Ordering::Relaxed);
        assert_eq!(next().await, Ok(0));
        emulator.unplug();
        absent(next().await).await;
    }
}

#[tokio::test(start_paused = true)]
async fn scans_are_merged_in_the_frame_of_the_vehicle() {
    limit();
    let emulator = Emulator::builder().world(Fixed::filled(1000)).build();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    let scan = sensor.scan(tokio_scip::Window::new(384..=384).unwrap()).await.unwrap();
    let pose = merged::parse("-0.5,0.1,180").unwrap();
    let point = pose.transform_scan(&scan).next().unwrap();
    assert!((point.x + 1.5).abs() < 1e-5 && (point.y - 0.1).abs() < 1e-5, "{point:?}");
    assert_eq!(merged::parse("1,2"), None);
    assert!(merged::parse("1,2,0,upside-down").unwrap().upside_down);

    // A sensor that is lost leaves the cloud.
    let mut scans = sensor.scans(scan.window(), tokio_scip::Rate::hz(10.0)).await.unwrap();
    scans.next().await.unwrap().unwrap();
    let (sensors, mut cloud) = ([Mounted { port: "rear".to_owned(), pose, scans }], Vec::new());
    assert!(merged::merge(&sensors, &mut cloud).is_empty());
    assert_eq!(cloud.len(), 1);
    emulator.unplug();
    sleep(ms(500)).await;
    let reasons = merged::merge(&sensors, &mut cloud);
    assert!(reasons[0].starts_with("rear: ") && reasons[0].contains("no port"), "{reasons:?}");
    assert!(cloud.is_empty());
}

#[tokio::test(start_paused = true)]
async fn odometry_is_within_5_cm_over_2_m() {
    limit();
    for seed in seeds("SCIP_ODOMETRY", 1) {
        let emulator = odometry::emulated::sensor(seed);
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await.unwrap();
        let mut odometry = odometry::Odometry::default();
        let (mut way, mut last) = (0.0, Pose::default());
        let mut worst: (f64, f64) = (0.0, 0.0);
        for _ in 0..65 {
            let pose = odometry.add(&scans.next().await.unwrap().unwrap());
            let truth = odometry::emulated::truth(&emulator).unwrap();
            way += (truth.x - last.x).hypot(truth.y - last.y);
            last = truth;
            let error = truth.inverse() * pose;
            worst = (worst.0.max(error.x.hypot(error.y)), worst.1.max(error.heading.abs()));
        }
        println!("{seed}: at most {:.3} m and {:.2}° off", worst.0, worst.1.to_degrees());
        assert!(way > 2.0, "{way}");
        assert!(worst.0 < 0.05 && worst.1 < 1f64.to_radians(), "{seed}: {worst:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_shutdown_frees_the_port_with_the_laser_off() {
    limit();
    let emulator = Emulator::default();
    let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
    graceful_shutdown::run(sensor, sleep(ms(1000))).await.unwrap();
    assert!(!emulator.is_laser_on() && !emulator.is_connected());
}

/// In real time: the link is the standard input and output of a real program.
#[cfg(unix)]
#[tokio::test]
async fn a_program_that_ends_is_started_again() {
    limit();
    let emulator = Emulator::default();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let (hang_up, _) = tokio::sync::broadcast::channel::<()>(1);
    let hang_ups = hang_up.clone();
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            let (emulator, mut hang_up) = (emulator.clone(), hang_ups.subscribe());
            tokio::spawn(async move {
                tokio::select! {
                    _ = emulator.serve(client) => {}
                    _ = hang_up.recv() => {}
                }
            });
        }
    });
    let command = format!("exec 3<>/dev/tcp/127.0.0.1/{port}; cat <&3 & exec cat >&3");
    let program = own_transport::Program::new(format!("exec bash -c '{command}'"));
    let sensor = Sensor::builder().connect(program).await.unwrap();
    let mut state = sensor.watch_state();
    hang_up.send(()).unwrap();
    state.wait_for(|state| !matches!(state, State::Connected { .. })).await.unwrap();
    state.wait_for(|state| matches!(state, State::Connected { .. })).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_fleet_of_a_hundred_sensors_keeps_its_rate() {
    limit();
    let fleet = fleet::open(vec!["emulated".to_owned(); 100]).await.unwrap();
    fleet::report(&fleet).await; // the sensors start
    for _ in 0..5 {
        assert_eq!(fleet::report(&fleet).await, ["100 sensors, 1000 scans/s"]);
    }
}
