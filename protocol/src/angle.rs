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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_turn_is_positive_from_both_sides() {
        for angle in [PI, -PI, 3.0 * PI, -3.0 * PI, 5.0 * PI] {
            assert!((wrap(angle) - PI).abs() < 1e-12, "{angle}");
        }
        assert_eq!(wrap(-PI), PI);
    }

    #[test]
    fn wrapping_changes_whole_turns_only_and_ends_in_the_interval() {
        for i in -1000..1000 {
            let angle = f64::from(i) * 0.0317;
            let wrapped = wrap(angle);
            let turns = (angle - wrapped) / TAU;
            assert!(wrapped > -PI && wrapped <= PI && (turns - turns.round()).abs() < 1e-9, "{angle}");
        }
        assert!(wrap(f64::NAN).is_nan() && !wrap(f64::INFINITY).is_finite());
    }

    #[test]
    fn a_difference_goes_the_short_way_over_the_seam() {
        assert!((difference(3.1, -3.1) - (6.2 - TAU)).abs() < 1e-12);
    }
}
