//! The driver reaches the rate that the line can carry, at every baud rate: on the paused
//! clock, with a sensor that answers at once and sends at the baud rate.

use crate::common::{builder, reply_len};
use tokio::time::Instant;
use tokio_scip::{BaudRate, Rate, Window};
use urg_emulator::{Emulator, Fixed, Pace};

const SCANS: u32 = 200;

/// Measures the scans a second of `window` at [`Rate::UNLIMITED`].
async fn rate(window: Window, speed: BaudRate) -> f64 {
    let world = Fixed::filled(1234);
    let emulator = Emulator::builder().world(world).baud_rate(speed).pace(Pace::AtOnce).build();
    let sensor = builder().connect(emulator).await.unwrap();
    let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
    stream.next().await.unwrap().unwrap();
    let start = Instant::now();
    for _ in 0..SCANS {
        stream.next().await.unwrap().unwrap();
    }
    f64::from(SCANS) / start.elapsed().as_secs_f64()
}

/// Returns the seconds that a `G` and its reply take on the line.
fn exchange(window: Window, speed: BaudRate) -> f64 {
    let bytes = "G04472501\n".len() + reply_len(window);
    bytes as f64 * 10.0 / f64::from(u32::from(speed))
}

#[tokio::test(start_paused = true)]
async fn the_line_is_used_to_99_percent() {
    for speed in BaudRate::ALL {
        for window in [Window::DETECTION, Window::FULL] {
            // Where polls cannot differ, a fence precedes each poll.
            let fence = if window == Window::FULL { "G38438401\n".len() + 16 } else { 0 };
            let fence = fence as f64 * 10.0 / f64::from(u32::from(speed));
            let exact = exchange(window, speed) + fence;
            // The timer's resolution of 1 ms matters only on fast lines.
            let carried =
                if speed <= BaudRate::B115200 { exact } else { (exact * 1e3).ceil() / 1e3 };
            // A fence is an exchange of its own, and waits for the timer, too.
            let carried = if fence > 0.0 { carried + 2e-3 } else { carried };
            let reached = rate(window, speed).await;
            let share = reached * carried;
            println!(
                "{speed} {window}: {reached:.3} of {:.3} scans/s, {:.2} %",
                1.0 / exact,
                share * 100.0
            );
            assert!(share >= 0.99, "{reached} scans a second of {window} at {speed} baud");
            assert!(reached * exact <= 1.0, "faster than the line: {reached} at {speed} baud");
        }
    }
}
