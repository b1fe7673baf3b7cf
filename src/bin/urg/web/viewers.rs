//! The places of those who take streams of scans. There is a limit, so that the
//! program's memory is bounded, and a newcomer gets a place also if clients that
//! do not read have taken all of them.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::server::Connection;

/// So many streams of scans may be open at a time.
const MAX_VIEWERS: usize = 32;
/// An address with more viewers than this makes room by its oldest one.
const FAIR_SHARE: usize = MAX_VIEWERS / 2;
/// A viewer that takes nothing for this time makes room first.
const STALL_LIMIT: Duration = Duration::from_secs(2);

/// All places that are taken.
#[derive(Debug, Default)]
pub(super) struct Viewers {
    /// In the order in which they were taken.
    places: Mutex<Vec<Arc<Place>>>,
}

/// One of them.
#[derive(Debug)]
pub(super) struct Place {
    address: IpAddr,
    connection: Weak<Connection>,
    /// The time when the viewer was handed data last; `None` while it waits for more.
    handed_at: Mutex<Option<Instant>>,
}

/// A connection's hold on its place, which ends with the drop. It lasts as long as the
/// connection, and not only as long as there are scans to hand over: until the client
/// has taken them, they are in memory.
#[derive(Debug)]
pub(super) struct Seat {
    viewers: Arc<Viewers>,
    pub(super) place: Arc<Place>,
}

impl Viewers {
    pub(super) fn len(&self) -> usize {
        lock(&self.places).len()
    }

    /// Takes a place for a connection, if need be that of another one, which is
    /// closed. Returns `None` if nobody has to make room.
    pub(super) fn admit(self: &Arc<Self>, connection: &Arc<Connection>) -> Option<Seat> {
        let place = Arc::new(Place {
            address: connection.address,
            connection: Arc::downgrade(connection),
            handed_at: Mutex::new(None),
        });
        let mut places = lock(&self.places);
        let evicted = match places.len() {
            0..MAX_VIEWERS => None,
            _ => {
                let now = Instant::now();
                let standings = places
                    .iter()
                    .map(|place| Standing { address: place.address, stalled: place.stalled(now) });
                Some(to_evict(&standings.collect::<Vec<_>>())?)
            }
        };
        let evicted = evicted.map(|index| places.remove(index));
        places.push(Arc::clone(&place));
        // A seat that is dropped needs the lock.
        drop(places);
        if let Some(connection) = evicted.and_then(|place| place.connection.upgrade()) {
            connection.close();
        }
        Some(Seat { viewers: Arc::clone(self), place })
    }
}

impl Place {
    fn stalled(&self, now: Instant) -> Duration {
        lock(&self.handed_at).map_or(Duration::ZERO, |at| now.saturating_duration_since(at))
    }

    /// Notes that the viewer waits for data.
    pub(super) fn waits(&self) {
        *lock(&self.handed_at) = None;
    }

    /// Notes that the viewer was handed data.
    pub(super) fn handed(&self) {
        *lock(&self.handed_at) = Some(Instant::now());
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        lock(&self.viewers.places).retain(|place| !Arc::ptr_eq(place, &self.place));
    }
}

/// The properties that decide which viewer has to make room.
#[derive(Debug, Clone, Copy)]
struct Standing {
    address: IpAddr,
    /// For how long the viewer has taken nothing.
    stalled: Duration,
}

/// Returns the viewer that has to make room: the one that has stalled longest,
/// or else the oldest one of an address that has more than its share.
fn to_evict(viewers: &[Standing]) -> Option<usize> {
    let stalled = (0..).zip(viewers).filter(|(_, viewer)| viewer.stalled >= STALL_LIMIT);
    let longest = stalled.max_by_key(|(_, viewer)| viewer.stalled).map(|(index, _)| index);
    longest.or_else(|| {
        viewers.iter().position(|oldest| {
            let of_address = viewers.iter().filter(|viewer| viewer.address == oldest.address);
            of_address.count() > FAIR_SHARE
        })
    })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing panics while it is held.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn viewers(addresses: impl IntoIterator<Item = u8>) -> Vec<Standing> {
        let standing =
            |last| Standing { address: IpAddr::from([192, 168, 0, last]), stalled: Duration::ZERO };
        addresses.into_iter().map(standing).collect()
    }

    #[test]
    fn the_viewer_that_has_stalled_longest_makes_room() {
        let mut viewers = viewers(0..32);
        assert_eq!(to_evict(&viewers), None, "all of them read, each from its own address");
        viewers[7].stalled = Duration::from_secs(3);
        viewers[9].stalled = Duration::from_secs(4);
        viewers[11].stalled = Duration::from_secs(1);
        assert_eq!(to_evict(&viewers), Some(9));
    }

    #[test]
    fn the_oldest_of_an_address_with_more_than_its_share_makes_room() {
        let mut crowd = viewers((0..15).chain([99; 17]));
        assert_eq!(to_evict(&crowd), Some(15));
        crowd.swap_remove(20);
        assert_eq!(to_evict(&crowd), None, "half of the places are a fair share");
    }
}
