//! The windows that keys step through.

use tokio_scip::Window;

/// The cluster counts that a key steps through.
const CLUSTERS: [u8; 4] = [1, 2, 4, 8];
/// The steps by which an arrow key turns or widens the window: 15 degrees.
pub(super) const ARROW_STEPS: i32 = 43;
/// A window that is narrowed keeps at least so many steps.
const MIN_STEPS: i32 = 86;

/// Returns the next one of the windows that people want most, at the same cluster
/// count.
pub(super) fn next_window(window: Window) -> Window {
    let degrees = |most: f64| Window::degrees(-most..=most).unwrap_or(Window::DETECTION);
    let windows = [Window::DETECTION, degrees(90.0), degrees(45.0), Window::FULL];
    let same = |other: &Window| (other.start(), other.end()) == (window.start(), window.end());
    // From any other window, and from the last of them, to the first.
    let next = windows.iter().skip_while(|other| !same(other)).nth(1);
    let next = next.copied().unwrap_or(Window::DETECTION);
    next.with_cluster_count(window.cluster_count()).unwrap_or(next)
}

/// Returns the window with the next cluster count.
pub(super) fn next_cluster(window: Window) -> Window {
    let next = CLUSTERS.into_iter().find(|count| *count > window.cluster_count()).unwrap_or(1);
    window.with_cluster_count(next).unwrap_or(window)
}

/// Returns the window with its two ends moved by so many steps, as far as the sensor
/// can look. It keeps its width when both move the same way.
pub(super) fn moved(window: Window, start: i32, end: i32) -> Window {
    let seen = Window::DETECTION;
    let (least, most) = (i32::from(seen.start().number()), i32::from(seen.end().number()));
    let from = i32::from(window.start().number());
    let to = i32::from(window.end().number());
    let (from, to) = if start == end {
        let by = if start > 0 {
            start.min((most - to).max(0))
        } else {
            start.max((least - from).min(0))
        };
        (from + by, to + by)
    } else if end > 0 {
        ((from + start).max(least.min(from)), (to + end).min(most.max(to)))
    } else if to - from + 1 + end - start < MIN_STEPS {
        (from, to)
    } else {
        (from + start, to + end)
    };
    let steps = u16::try_from(from).ok().zip(u16::try_from(to).ok());
    steps
        .and_then(|(from, to)| Window::new(from..=to).ok())
        .and_then(|moved| moved.with_cluster_count(window.cluster_count()).ok())
        .unwrap_or(window)
}
