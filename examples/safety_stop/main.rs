//! A vehicle that slows down and stops for an obstacle, and stops whenever it cannot see:
//!
//! ```sh
//! cargo run --example safety_stop emulated
//! cargo run --example safety_stop /dev/ttyACM0 interlock    # Enter permits the restart
//! ```
//!
//! - The **protective field** reaches as far as `TERMS` demand: an obstacle at least `WIDTH`
//!   wide in it stops the vehicle within `Terms::response`, whatever happens to the sensor, its
//!   link or its replies.
//! - Two of three scans that do not show the field clear stop the vehicle. One does not, but the
//!   permission to move still ends `Terms::limit` after the last scan that did.
//! - In the **warning field** in front of it an obstacle slows the vehicle down.
//! - After a stop, and at the start, the vehicle waits until the protective field was clear for
//!   `RESTART`. With an **interlock** it also waits for a reset, given while the field is clear.
//!
//! **This is no safety device.** Neither the sensor, nor this library, nor the operating
//! system is certified, and a flipped bit on the line can change a distance. An object that
//! returns no light looks like free space if it may be out of range. Use it in addition to
//! a bumper that stops the vehicle for certain.

#[path = "../port/mod.rs"]
mod port;
pub(crate) mod zone;

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep_until};
use tokio_scip::{ErrorChain, Geometry, Rate, Scan, ScanStream, Sensor, SensorBuilder};

use self::zone::Zone;

/// Terms of the minimum distance `S = K x T + C` of ISO 13855.
pub(crate) struct Terms {
    /// `K`: speed at which vehicle and obstacle approach each other, in m/s.
    pub(crate) approach: f64,
    /// Longest time from an obstacle's appearance to the end of the revolution that measures it.
    pub(crate) revolution: Duration,
    /// Time from there until the scan is received.
    pub(crate) reply: Duration,
    /// How long the vehicle may move after the last scan that showed the field clear.
    pub(crate) limit: Duration,
    /// Time from the output to standstill.
    pub(crate) braking: Duration,
    /// `C`: error of a range, and what reaches out of the plane that the sensor sees, in metres.
    pub(crate) supplement: f64,
}

/// Terms of this example's vehicle: measure your own.
pub(crate) const TERMS: Terms = Terms {
    approach: 0.5,
    revolution: Duration::from_millis(100),
    reply: Duration::from_millis(50),
    limit: Duration::from_millis(500),
    braking: Duration::from_millis(250),
    supplement: 0.15,
};

impl Terms {
    /// Returns the longest time from an obstacle's appearance to the output "stop".
    pub(crate) fn response(&self) -> Duration {
        self.revolution + self.reply + self.limit
    }

    /// Returns `S`: how far the protective field reaches, in metres.
    pub(crate) fn distance(&self) -> f64 {
        self.approach * (self.response() + self.braking).as_secs_f64() + self.supplement
    }
}

/// Width of the smallest obstacle, in metres.
pub(crate) const WIDTH: f64 = 0.1;
/// The field must be clear for this time before the vehicle moves again.
pub(crate) const RESTART: Duration = Duration::from_secs(1);
/// How far the fields reach to each side, in degrees.
const SIDE: i32 = 30;

/// With the default of 500 ms, each lost reply would stop the vehicle. A sensor answers at the end of a
/// revolution, and may need another one to switch its laser on.
pub(crate) fn settings() -> SensorBuilder {
    Sensor::builder().reply_latency(Duration::from_millis(230))
}

/// Output to the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Motion {
    Stop,
    Slow,
    Drive,
}

/// The two fields, ahead of the sensor. In a real room up to two thirds of the rays have no distance:
/// they count only if an obstacle could hide behind them.
pub(crate) struct Fields {
    protective: Zone,
    warning: Zone,
}

impl Fields {
    pub(crate) fn new(geometry: Geometry) -> Result<Self, String> {
        let field = |metres: f64| {
            let arc = (-SIDE..=SIDE).map(|degrees| f64::from(degrees).to_radians());
            let arc = arc.map(|angle| (metres * angle.cos(), metres * angle.sin()));
            let outline: Vec<_> = std::iter::once((0.0, 0.0)).chain(arc).collect();
            Zone::new(geometry, &outline, WIDTH)
        };
        let reach = TERMS.distance();
        Ok(Self { protective: field(reach)?, warning: field(2.0 * reach)? })
    }

    pub(crate) async fn scans(&self, sensor: &Sensor) -> Result<ScanStream, tokio_scip::Error> {
        sensor.scans(self.warning.window(), Rate::hz(10.0)).await
    }
}

/// Decides from scan to scan.
struct Guard {
    fields: Fields,
    /// Whether each of the last three scans showed the protective field clear.
    votes: [bool; 3],
    /// End of the permission to move.
    until: Instant,
    /// Time since which each scan has shown the protective field clear.
    clear_since: Option<Instant>,
    needs_reset: bool,
    is_reset: bool,
    is_moving: bool,
}

impl Guard {
    fn take(&mut self, scan: &Scan) -> Motion {
        let (received, is_clear) = (scan.received_at(), self.fields.protective.check(scan).is_ok());
        self.votes = [self.votes[1], self.votes[2], is_clear];
        if is_clear {
            self.until = received + TERMS.limit;
            self.clear_since.get_or_insert(received);
        } else {
            self.clear_since = None;
        }
        let is_permitted = match self.is_moving {
            true => self.votes.iter().filter(|is_clear| **is_clear).count() >= 2,
            false => {
                self.clear_since.is_some_and(|since| received - since >= RESTART)
                    && (!self.needs_reset || self.is_reset)
            }
        };
        if !is_permitted || Instant::now() >= self.until {
            return self.stop();
        }
        self.is_moving = true;
        if self.fields.warning.check(scan).is_ok() { Motion::Drive } else { Motion::Slow }
    }

    /// A reset counts for the next start only, and while the field is clear.
    fn stop(&mut self) -> Motion {
        self.is_reset &= !self.is_moving && self.clear_since.is_some();
        self.is_moving = false;
        Motion::Stop
    }
}

/// Permission to move. Dropping it, for any reason, stops the vehicle.
struct Permission(watch::Sender<Motion>);

impl Permission {
    fn set(&self, motion: Motion) {
        self.0.send_if_modified(|now| std::mem::replace(now, motion) != motion);
    }
}

impl Drop for Permission {
    fn drop(&mut self) {
        self.set(Motion::Stop);
    }
}

/// Sets `output` until the stream ends. With an interlock, each start needs a notification. An
/// error does not stop the vehicle: the last clear scan counts until it is too old.
pub(crate) async fn guard(
    fields: Fields,
    mut scans: ScanStream,
    output: watch::Sender<Motion>,
    interlock: Option<Arc<Notify>>,
) {
    let permission = Permission(output);
    let (needs_reset, reset) = (interlock.is_some(), interlock.unwrap_or_default());
    let mut guard = Guard {
        fields,
        votes: [false; 3],
        until: Instant::now(),
        clear_since: None,
        needs_reset,
        is_reset: false,
        is_moving: false,
    };
    loop {
        tokio::select! {
            // The limit first: it holds even if scans arrive faster than they are checked.
            biased;
            () = sleep_until(guard.until), if guard.clear_since.is_some() || guard.is_moving => {
                guard.clear_since = None;
                permission.set(guard.stop());
            }
            () = reset.notified() => guard.is_reset = guard.clear_since.is_some(),
            scan = scans.next() => match scan {
                Some(Ok(scan)) => permission.set(guard.take(&scan)),
                Some(Err(error)) => eprintln!("no scan: {}", ErrorChain(&error)),
                None => break,
            },
        }
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = port::open(settings(), &port::argument()).await?;
    let has_interlock = std::env::args().nth(2).is_some_and(|argument| argument == "interlock");
    let interlock = has_interlock.then(Arc::<Notify>::default);
    if let Some(reset) = interlock.clone() {
        tokio::spawn(async move {
            let mut lines = BufReader::new(tokio::io::stdin()).lines();
            while let Ok(Some(_)) = lines.next_line().await {
                reset.notify_one();
            }
        });
    }
    let fields = Fields::new(sensor.geometry().await?)?;
    let scans = fields.scans(&sensor).await?;
    println!("stops within {:?} of an obstacle in {:.2} m", TERMS.response(), TERMS.distance());
    let (output, mut motion) = watch::channel(Motion::Stop);
    tokio::spawn(guard(fields, scans, output, interlock));
    println!("Stop");
    while motion.changed().await.is_ok() {
        println!("{:?}", *motion.borrow_and_update());
    }
    Ok(())
}
