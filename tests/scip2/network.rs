//! A network that stalls and then delivers everything at once. `Stats::lost` counts what a stream lacks.

use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{sleep, timeout};
use tokio_scip::port::Port;
use tokio_scip::{Error, Rate, Window};
use urg_emulator::{Emulator, Fault, Faults, Link, Model};

use super::{next, numbered, revolution};
use crate::common::random::{Random, seeds};
use crate::common::{ConnectFn, builder, ms};

/// Network between the driver and a sensor. While it stalls, no byte arrives, and none is lost.
#[derive(Debug, Clone, Default)]
struct Network(Arc<Mutex<Net>>);

#[derive(Debug, Default)]
struct Net {
    stalls: bool,
    wakers: Vec<Waker>,
}

impl Network {
    fn stall(&self, stalls: bool) {
        let mut net = self.0.lock().unwrap();
        net.stalls = stalls;
        std::mem::take(&mut net.wakers).into_iter().for_each(Waker::wake);
    }

    fn stalls(&self, cx: &Context<'_>) -> bool {
        let mut net = self.0.lock().unwrap();
        if net.stalls {
            net.wakers.push(cx.waker().clone());
        }
        net.stalls
    }

    fn connect(
        &self,
        emulator: &Emulator,
    ) -> ConnectFn<impl FnMut() -> Result<Connection, Error> + Send + 'static> {
        let (network, emulator) = (self.clone(), emulator.clone());
        ConnectFn(move || {
            let (network, link) = (network.clone(), emulator.link());
            Ok(Connection { network, link, unsent: Vec::new() })
        })
    }
}

struct Connection {
    network: Network,
    link: Link,
    unsent: Vec<u8>,
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.network.stalls(cx) {
            return Poll::Pending;
        }
        let unsent = std::mem::take(&mut self.unsent);
        if !unsent.is_empty() {
            let written = Pin::new(&mut self.link).poll_write(cx, &unsent);
            assert!(matches!(written, Poll::Ready(Ok(all)) if all == unsent.len()), "{written:?}");
        }
        Pin::new(&mut self.link).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        if self.network.stalls(cx) {
            self.unsent.extend(bytes);
            return Poll::Ready(Ok(bytes.len()));
        }
        Pin::new(&mut self.link).poll_write(cx, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl Port for Connection {}

/// Scans that a stream lacks although it should get each: for a request, a wider window, a fault or a
/// stall of up to 2.5 s, during which the driver gives the stream up.
#[tokio::test(start_paused = true)]
async fn each_scan_that_a_stream_lacks_is_lost() {
    for seed in seeds("SCIP_LOST", 30) {
        let mut random = Random::new(seed);
        let model = *random.pick(&[Model::Ust10lx, Model::Utm30lx, Model::Urg04lxUg01]);
        let (emulator, network) = (numbered(model).build(), Network::default());
        let sensor = builder().depth(10_000).connect(network.connect(&emulator)).await.unwrap();
        let window = Window::new(200..=300).unwrap();
        let mut stream = sensor.scans(window, Rate::UNLIMITED).await.unwrap();
        let (mut latest, mut gaps) = (revolution(&next(&mut stream).await), 0);
        let mut others = Vec::new();
        for n in 0..8 {
            match random.below(9) {
                0 => drop(sensor.sensor_state().await.unwrap()),
                1 => drop(sensor.scan(Window::new(199 - n..=300).unwrap()).await.unwrap()),
                2 => sensor.laser_on().await.unwrap(),
                3 => {
                    let window = Window::new(250..=310 + random.below(100) as u16).unwrap();
                    let rate = *random.pick(&[Rate::hz(0.5), Rate::hz(7.0), Rate::UNLIMITED]);
                    others.push(sensor.scans(window, rate).await.unwrap());
                }
                4 => others.clear(),
                5 => {
                    use Fault::{Damaged, Lost, Merged, WrongSum};
                    let fault = random.pick(&[WrongSum, Damaged, Lost, Merged]).clone();
                    emulator.set_faults(Faults::none().rate(0.1, fault).seed(seed));
                }
                _ => {
                    network.stall(true);
                    sleep(random.ms(2500)).await;
                    network.stall(false);
                }
            }
            sleep(random.ms(2000)).await;
            emulator.set_faults(Faults::none());
        }
        sleep(ms(3000)).await;
        network.stall(true);
        while let Ok(item) = timeout(ms(1), stream.next()).await {
            let Ok(scan) = item.unwrap() else { continue };
            let now = revolution(&scan);
            assert_ne!(now, latest, "seed {seed}");
            gaps += u64::from((now + 3000 - latest) % 3000 - 1);
            latest = now;
        }
        assert_eq!(sensor.stats().lost, gaps, "seed {seed}: {model:?}");
    }
}

/// Its reader is dropped while it runs, after a request or in a stall, or its laser is switched off.
#[tokio::test(start_paused = true)]
async fn scans_that_nobody_wants_are_not_lost() {
    for (what, slow) in (0..4).flat_map(|what| [None, Some(0.5), Some(0.01)].map(|it| (what, it))) {
        let (emulator, network) = (numbered(Model::Ust10lx).build(), Network::default());
        let sensor = builder().connect(network.connect(&emulator)).await.unwrap();
        let mut streams = Vec::new();
        if let Some(rate) = slow {
            streams.push(sensor.scans(Window::DETECTION, Rate::hz(rate)).await.unwrap());
        }
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        next(&mut stream).await;
        match what {
            0 => {}
            1 => drop(sensor.sensor_state().await.unwrap()),
            2 => sensor.laser_off().await.unwrap(),
            _ => {
                network.stall(true);
                sleep(ms(2000)).await;
            }
        }
        if what != 2 {
            drop(stream);
        }
        sleep(ms(100)).await;
        network.stall(false);
        sleep(ms(20_000)).await;
        if what == 2 {
            sensor.laser_on().await.unwrap();
        }
        let mut stream = sensor.scans(Window::DETECTION, Rate::UNLIMITED).await.unwrap();
        for _ in 0..10 {
            next(&mut stream).await;
        }
        let lost = sensor.stats().lost;
        assert!(lost < 10, "{what} {slow:?}: {lost}");
    }
}
