//! Counts people at doors, each with a sensor:
//!
//! ```sh
//! cargo run --example count_people serial:H0713090 serial:H0713091
//! cargo run --example count_people emulated
//! ```
//!
//! The first scan of a link shows the empty doorway. After a cable was pulled and plugged in
//! again, counting continues. The sensor may have been moved meanwhile, so the program learns
//! the doorway again.

mod port;

use tokio::sync::mpsc;
use tokio_scip::{Error, Rate, Scan, Sensor, Window};

/// Distances of the empty doorway.
#[derive(Default)]
pub(crate) struct Doorway {
    /// The background, and the number of reconnects before its scan.
    background: Option<(u64, Vec<Option<u16>>)>,
}

impl Doorway {
    /// Counts the objects, at least 5 directions wide and 200 mm in front of the background.
    pub(crate) fn count(&mut self, scan: &Scan) -> usize {
        let distances = || scan.measurements().map(|measurement| measurement.distance());
        let link = scan.reconnects();
        let (_, background) = match &mut self.background {
            Some(known) if known.0 == link => known,
            other => other.insert((link, distances().collect())),
        };
        let near: Vec<bool> = distances()
            .zip(background)
            .map(|(now, known)| matches!((now, known), (Some(a), Some(b)) if a + 200 < *b))
            .collect();
        near.chunk_by(|a, b| a == b)
            .filter(|run| run.first() == Some(&true) && run.len() >= 5)
            .count()
    }
}

/// Sends the number of people at a door whenever it changes.
pub(crate) async fn watch(
    door: String,
    sensor: Sensor,
    people: mpsc::Sender<(String, usize)>,
) -> Result<(), Error> {
    let mut scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    let (mut doorway, mut last) = (Doorway::default(), None);
    while let Some(scan) = scans.next().await {
        match scan {
            Ok(scan) => {
                let count = doorway.count(&scan);
                if last != Some(count) && people.send((door.clone(), count)).await.is_err() {
                    break; // no one counts any more
                }
                last = Some(count);
            }
            Err(error) => eprintln!("{door} does not see: {}", error.chain()),
        }
    }
    Ok(())
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (people, mut counts) = mpsc::channel(16);
    for door in std::env::args().skip(1) {
        let builder = Sensor::builder().name(&door).wait_for_sensor(true);
        let sensor = port::open(builder, &door).await?;
        tokio::spawn(watch(door, sensor, people.clone()));
    }
    drop(people);
    while let Some((door, count)) = counts.recv().await {
        println!("{door}: {count} people");
    }
    Ok(())
}
