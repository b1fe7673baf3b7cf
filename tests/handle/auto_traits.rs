//! Checks at compile time that handles and data can be moved between tasks and shared
//! between threads as services need it.

use std::fmt::Debug;

use futures::stream::{FusedStream, Stream};
use tokio_scip::port::Connect;
use tokio_scip::port::StreamPort;
use tokio_scip::scan::ScanBuilder;
use tokio_scip::state::{StaleError, StateWatch};
use tokio_scip::stream::StreamBuilder;
use tokio_scip::{
    Driver, Endpoint, Error, Freshness, Geometry, Point, Rate, ReplyObservation, Scan, ScanStream,
    Sensor, SensorBuilder, State, Stats, Version, Window,
};
use urg_emulator::Emulator;

fn shared<T: Send + Sync + Unpin + Debug + 'static>() {}
fn sent<T: Send + 'static>(_: &T) {}
fn stream<T: FusedStream + Stream + Clone + Unpin + Send + Sync + 'static>() {}

#[test]
fn handles_streams_and_data_are_shared_between_threads() {
    shared::<Sensor>();
    shared::<SensorBuilder>();
    shared::<Endpoint>();
    shared::<StreamPort<tokio::io::Empty>>();
    shared::<ScanStream>();
    shared::<StreamBuilder>();
    shared::<StateWatch>();
    shared::<Freshness>();
    shared::<StaleError>();
    shared::<Geometry>();
    shared::<Scan>();
    shared::<ScanBuilder>();
    shared::<Point>();
    shared::<Window>();
    shared::<Rate>();
    shared::<Version>();
    shared::<State>();
    shared::<Stats>();
    shared::<Error>();
    shared::<ReplyObservation>();
}

#[test]
fn streams_need_no_pinning_and_are_fused() {
    stream::<ScanStream>();
}

#[test]
fn the_driver_is_a_future_that_can_be_spawned() {
    fn spawned<T: Future<Output = Result<(), Error>> + Send + Unpin + Debug + 'static>() {}
    spawned::<Driver>();
    let (_sensor, driver) = Sensor::builder().build(Emulator::builder().build());
    assert_eq!(format!("{driver:?}"), "Driver { .. }");
}

/// Never called: the test is that it compiles.
#[allow(dead_code)]
fn every_future_can_be_awaited_in_a_spawned_task(
    sensor: &'static Sensor,
    stream: &'static mut ScanStream,
    [connected, changed, waiting]: &'static mut [StateWatch; 3],
    connect: impl Connect,
) {
    sent(&Sensor::open("/dev/ttyACM0"));
    sent(&Sensor::builder().open("/dev/ttyACM0"));
    sent(&Sensor::builder().attach(tokio::io::empty()));
    sent(&Sensor::builder().connect(connect));
    sent(&sensor.version());
    sent(&sensor.geometry());
    sent(&sensor.sensor_state());
    sent(&sensor.laser_on());
    sent(&sensor.laser_off());
    sent(&sensor.set_baud_rate(tokio_scip::BaudRate::B19200));
    sent(&sensor.reboot());
    sent(&sensor.scan(Window::FULL));
    sent(&sensor.scans(Window::FULL, Rate::UNLIMITED).into_future());
    sent(&sensor.close());
    sent(&stream.next());
    sent(&connected.connected());
    sent(&changed.changed());
    sent(&waiting.wait_for(|_| true));
    #[cfg(feature = "serial")]
    sent(&tokio_scip::port::list());
}
