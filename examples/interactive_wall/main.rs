//! Hands on a wall as cursors for TouchDesigner, Unity and others that read TUIO 1.1. The sensor
//! lies flat beside the wall and measures right above it. Beside a floor it sees feet:
//!
//! ```sh
//! cargo run --example interactive_wall /dev/ttyACM0 127.0.0.1:3333
//! cargo run --example interactive_wall emulated
//! ```
//!
//! Keep away from the wall in the first second, which is the background. Then touch the corners of
//! the picture, or pass them after the address, as the program printed them before.
//!
//! A hand right behind another is hidden, and two that are closer than 6 cm are one.

mod cursors;
mod emulated;
mod finder;
mod picture;
#[path = "../port/mod.rs"]
mod port;

use tokio::net::UdpSocket;
use tokio_scip::{Rate, ScanStream, Sensor, Window};

use self::cursors::Cursors;
use self::finder::Finder;
pub(crate) use self::picture::{Picture, Spot};

pub(crate) type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// Sends a bundle for each scan. Each has all cursors, so a lost packet matters for 100 ms only.
pub(crate) async fn run(
    scans: ScanStream,
    corners: Option<[Spot; 4]>,
    socket: UdpSocket,
) -> Result<()> {
    println!("keep away from the wall for a second");
    let mut finder = Finder::learn(scans).await?;
    let corners = match corners {
        Some(corners) => corners,
        None => finder.corners().await?,
    };
    let picture = Picture::new(corners)?;
    let [a, b, c, d] = corners.map(|(x, y)| format!("{x:.3},{y:.3}"));
    println!("sends hands between {a} {b} {c} {d} to {}", socket.peer_addr()?);
    let source = format!("interactive_wall@{}", socket.local_addr()?.ip());
    let mut cursors = Cursors::default();
    loop {
        let (hands, now) = finder.next().await?;
        let inside = hands.into_iter().filter_map(|at| Some((at, picture.place(at)?)));
        cursors.follow(inside.collect(), now);
        // No one may listen yet.
        let _ = socket.send(&cursors.bundle(&source)?).await;
    }
}

/// Parses four corners, each as `X,Y` in metres.
fn parse(texts: &[String]) -> Option<[Spot; 4]> {
    let spot = |text: &String| {
        let (x, y) = text.split_once(',')?;
        Some((x.parse().ok()?, y.parse().ok()?))
    };
    texts.iter().map(spot).collect::<Option<Vec<_>>>()?.try_into().ok()
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(2).collect();
    let (target, corners) = match arguments.split_first() {
        Some((target, [])) => (target.as_str(), None),
        Some((target, texts)) => {
            (target.as_str(), Some(parse(texts).ok_or("expected four corners, each as X,Y")?))
        }
        None => ("127.0.0.1:3333", None),
    };
    let sensor = match port::argument().as_str() {
        "emulated" => Sensor::builder().connect(emulated::sensor()).await?,
        port => port::open(Sensor::builder(), port).await?,
    };
    let socket = UdpSocket::bind("0.0.0.0:0").await?;
    socket.connect(target).await?;
    let scans = sensor.scans(Window::DETECTION, Rate::hz(10.0)).await?;
    run(scans, corners, socket).await
}
