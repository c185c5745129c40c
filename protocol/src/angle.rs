//! Angles in radians: wrapping, differences, degrees at the edges.

use std::f64::consts::{PI, TAU};

/// `angle` in (−π, π]. Non-finite input stays non-finite.
pub fn wrap(angle: f64) -> f64 {
    let wrapped = angle - TAU * (angle / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// `a − b` the short way round, in (−π, π].
pub fn difference(a: f64, b: f64) -> f64 {
    wrap(a - b)
}
