//! Windows made wider.

#![allow(clippy::unwrap_used)]

use super::*;

fn window(start: u16, end: u16, cluster_count: u8) -> Window {
    Window::new(start..=end).unwrap().with_cluster_count(cluster_count).unwrap()
}

/// First and last step of every point.
fn points(window: Window) -> Vec<(u16, u16)> {
    let (end, cluster) = (window.end(), u16::from(window.cluster_count()));
    (window.start()..=end)
        .step_by(usize::from(cluster))
        .map(|first| (first, end.min(first + cluster - 1)))
        .collect()
}

#[test]
fn a_widened_window_keeps_the_points() {
    let mut refused = 0;
    for start in 0..=768 {
        for end in [start, start + 1, start + 7, start + 41, 725, 764, 767, 768] {
            if end < start || end > 768 {
                continue;
            }
            for cluster_count in [1, 2, 4, 5, 99] {
                for added in 0..4 {
                    let narrow = window(start, end, cluster_count);
                    let Some((wide, skip)) = narrow.widened(added) else {
                        refused += 1;
                        continue;
                    };
                    assert_eq!(wide.points(), narrow.points() + usize::from(added));
                    let kept = points(wide).into_iter().skip(skip).take(narrow.points());
                    assert!(kept.eq(points(narrow)), "{narrow} by {added}");
                }
            }
        }
    }
    assert!(refused > 0);
}
