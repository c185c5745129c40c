//! Walks that the scenario gives point by point: corners are rounded, so that nobody starts, stops or turns back at once.

use super::STEP_S;
use super::WARM_UP_S;
use super::steer::{STRIDE_M, TURN_RATE_RADPS, wrap};
use super::swing_rad;
use crate::world::person::Gait;

/// A place is the mean of the way over so long: from 1 m/s to rest in it.
const ROUNDED_S: f64 = 0.6;
/// Slower, nobody looks where he goes.
const LOOKING_MPS: f64 = 0.15;

/// Samples of the walk along `[time s, x m, y m]`, which are in order of time.
pub(super) fn walk(way: &[[f64; 3]], height_m: f64, steps: usize) -> Vec<Gait> {
    let half = (0.5 * ROUNDED_S / STEP_S) as i64;
    let place = |step: i64| {
        let sum = (-half..=half).map(|i| at(way, (step + i) as f64 * STEP_S - WARM_UP_S));
        let [x, y] = sum.fold([0.0; 2], |sum, [x, y]| [sum[0] + x, sum[1] + y]);
        [x, y].map(|sum| sum / (2 * half + 1) as f64)
    };
    let first_way = way.windows(2).find(|w| w[0][1..] != w[1][1..]);
    let mut heading_rad = first_way.map_or(0.0, |w| (w[1][2] - w[0][2]).atan2(w[1][1] - w[0][1]));
    let mut phase_rad = way.first().map_or(0.0, |[_, x, y]| 3.0 * x + 2.0 * y);
    let mut before = place(-1);
    (0..steps as i64)
        .map(|step| {
            let [x_m, y_m] = place(step);
            let (vx, vy) = ((x_m - before[0]) / STEP_S, (y_m - before[1]) / STEP_S);
            before = [x_m, y_m];
            let speed = vx.hypot(vy);
            if speed > LOOKING_MPS {
                let turn = wrap(vy.atan2(vx) - heading_rad);
                heading_rad += turn.clamp(-TURN_RATE_RADPS * STEP_S, TURN_RATE_RADPS * STEP_S);
            }
            phase_rad += std::f64::consts::TAU * speed * STEP_S / (STRIDE_M * height_m / 1.75);
            Gait { x_m, y_m, heading_rad, phase_rad, swing_rad: swing_rad(speed, height_m) }
        })
        .collect()
}

fn at(way: &[[f64; 3]], time_s: f64) -> [f64; 2] {
    let after = way.partition_point(|[t, ..]| *t <= time_s);
    match (after.checked_sub(1).map(|i| way[i]), way.get(after)) {
        (Some([t0, ax, ay]), Some([t1, bx, by])) => {
            let part = (time_s - t0) / (t1 - t0);
            [ax + part * (bx - ax), ay + part * (by - ay)]
        }
        (Some([_, x, y]), None) | (None, Some(&[_, x, y])) => [x, y],
        (None, None) => [0.0; 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_is_kept_to_with_rounded_corners_and_without_leaps() {
        let way = [[0.0, 0.0, 0.0], [2.0, 2.0, 0.0], [3.0, 2.0, 0.0], [5.0, 0.0, 0.0]];
        let walk = walk(&way, 1.75, 500);
        let step = |time_s: f64| &walk[((time_s + WARM_UP_S) / STEP_S).round() as usize];
        assert!((step(1.0).x_m - 1.0).abs() < 0.03 && (step(2.5).x_m - 2.0).abs() < 0.03);
        assert!((step(-1.0).x_m, step(5.9).x_m) == (0.0, 0.0) && step(2.5).swing_rad < 0.01);
        let mut speed = 0.0;
        for pair in walk.windows(2) {
            let now = (pair[1].x_m - pair[0].x_m) / STEP_S;
            assert!((now - speed).abs() < 2.0 * STEP_S && now.abs() < 1.01, "{now} after {speed}");
            speed = now;
        }
        // Turned back.
        assert!(wrap(step(4.5).heading_rad - std::f64::consts::PI).abs() < 0.1);
    }
}
