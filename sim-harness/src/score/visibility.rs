//! Which person-instants the team could have covered: at least half of the silhouette unhidden for two robots whose lines of
//! sight meet at |sin φ₀| ≥ 0.1, φ₀ being the angle at the person between them.

/// Least share of the silhouette that counts as seen.
pub const LEAST_FRACTION: f64 = 0.5;
/// Least |sin φ₀| for a pair of lines of sight.
pub const LEAST_SINE: f64 = 0.1;

/// Whether two of the robots could place somebody at `person_m`. `robots`: position and the share of the person that it sees.
pub fn coverable(person_m: [f64; 2], robots: &[([f64; 2], f64)]) -> bool {
    let seeing: Vec<[f64; 2]> = robots.iter().filter(|(_, seen)| *seen >= LEAST_FRACTION).map(|(at, _)| *at).collect();
    let sine = |a: &[f64; 2], b: &[f64; 2]| {
        let [ax, ay] = [a[0] - person_m[0], a[1] - person_m[1]];
        let [bx, by] = [b[0] - person_m[0], b[1] - person_m[1]];
        (ax * by - ay * bx).abs() / (ax.hypot(ay) * bx.hypot(by)).max(1e-9)
    };
    seeing.iter().enumerate().any(|(n, a)| seeing[n + 1..].iter().any(|b| sine(a, b) >= LEAST_SINE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_robots_at_a_right_angle_cover_and_one_alone_does_not() {
        assert!(coverable([1.0, 1.0], &[([0.0, 1.0], 0.5), ([1.0, 0.0], 1.0)]));
        assert!(!coverable([1.0, 1.0], &[([0.0, 1.0], 0.49), ([1.0, 0.0], 1.0)]));
    }

    #[test]
    fn lines_of_sight_that_hardly_cross_do_not_cover() {
        // Between two robots and on their line; then 0.2 m beside it at 2 m: φ₀ = 180° − 11.4°.
        assert!(!coverable([2.0, 0.0], &[([0.0, 0.0], 1.0), ([4.0, 0.0], 1.0)]));
        assert!(coverable([2.0, 0.2], &[([0.0, 0.0], 1.0), ([4.0, 0.0], 1.0)]));
        assert!(!coverable([2.0, 0.05], &[([0.0, 0.0], 1.0), ([4.0, 0.0], 1.0)]));
    }
}
