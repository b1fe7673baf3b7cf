#!/usr/bin/env bash
# Copper (cu-sensor-payloads 1.3.1, crates.io) loses points in `sort` of a cloud that is not full: they become (0, 0).
#
# `PointCloudSoa<N>` has room for `N` points. Expected of `sort`, "in place ... so it can be ready for merge sorts": the
# points that were pushed, in the order of their times. But it sorts all `N` places: the empty ones, with time 0, move
# to the front, and the newest points past the end. A full cloud loses none, but the number of each echo,
# `return_order`, stays where it was while its point moves.
set -euo pipefail
cd "$(dirname "$0")"
python3 - <<'END'
import subprocess

from place import cargo, compare

PROGRAM = """
use cu29::prelude::CuTime;
use cu_sensor_payloads::{PointCloud, PointCloudSoa};

/// Sorts the 682 points of a URG, pushed from the last to the first. The first 341 are second echoes.
fn sorted<const N: usize>() {
    let mut cloud = PointCloudSoa::<N>::default();
    for number in (0..682_u64).rev() {
        let (time, echo) = (CuTime::from_nanos(1_000_000 + number), u8::from(number < 341));
        cloud.push(PointCloud::new(time, 1.0 + number as f32, 0.0, 0.0, 0.0, Some(echo)));
    }
    cloud.sort();
    let points: Vec<_> = cloud.iter().collect();
    let in_order = points.windows(2).all(|pair| pair[0].tov <= pair[1].tov);
    let lost = points.iter().filter(|point| point.x.value == 0.0).count();
    let kept = points.iter().filter(|point| point.x.value > 0.0);
    let wrong = kept.filter(|point| (point.x.value < 342.0) != (point.return_order == 1)).count();
    println!("{} {in_order} {lost} {wrong}", points.len());
}

fn main() {
    sorted::<682>();
    sorted::<1024>();
}
"""
program = cargo(PROGRAM, 'cu-sensor-payloads = "=1.3.1"', 'cu29 = "=1.3.1"')
full, partly = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
compare({"points, in order, lost, with another's echo; full": full, "with room for 1024": partly}, {
    "points, in order, lost, with another's echo; full": "682 true 0 682",
    "with room for 1024": "682 true 342 0",
})
END
