//! The best of a grid, then Nelder and Mead's simplex (1965), in the plane.

/// Places of the grid along each side.
const GRID: usize = 81;
/// Simplex steps at most.
const MAX_STEPS: usize = 200;
/// Size of the simplex at which it ends, metres.
const TOLERANCE_M: f64 = 1e-5;

type Place = [f64; 2];

/// The least of `cost` within `reach_m` of `around`; infinite costs are forbidden places.
pub fn minimise(around: Place, reach_m: f64, cost: impl Fn(Place) -> f64) -> (Place, f64) {
    let step = 2.0 * reach_m / (GRID - 1) as f64;
    let at = |k: usize| step * k as f64 - reach_m;
    let mut best = (around, cost(around));
    for i in 0..GRID {
        for j in 0..GRID {
            let place = [around[0] + at(i), around[1] + at(j)];
            let value = cost(place);
            if value < best.1 {
                best = (place, value);
            }
        }
    }
    if best.1.is_infinite() { best } else { simplex(best.0, step, cost) }
}

fn simplex(start: Place, size: f64, cost: impl Fn(Place) -> f64) -> (Place, f64) {
    let corner = |place: Place| (place, cost(place));
    let mut corners = [corner(start), corner([start[0] + size, start[1]]), corner([start[0], start[1] + size])];
    for _ in 0..MAX_STEPS {
        corners.sort_by(|a, b| a.1.total_cmp(&b.1));
        let [(best, low), (second, middle), (worst, high)] = corners;
        let spread =
            (worst[0] - best[0]).hypot(worst[1] - best[1]).max((second[0] - best[0]).hypot(second[1] - best[1]));
        if spread < TOLERANCE_M {
            break;
        }
        let centre = [0.5 * (best[0] + second[0]), 0.5 * (best[1] + second[1])];
        let along = |t: f64| corner([centre[0] + t * (worst[0] - centre[0]), centre[1] + t * (worst[1] - centre[1])]);
        let reflected = along(-1.0);
        corners[2] = if reflected.1 < low {
            let further = along(-2.0);
            if further.1 < reflected.1 { further } else { reflected }
        } else if reflected.1 < middle {
            reflected
        } else {
            let nearer = if reflected.1 < high { along(-0.5) } else { along(0.5) };
            if nearer.1 < high.min(reflected.1) {
                nearer
            } else {
                let half = |p: Place| corner([0.5 * (p[0] + best[0]), 0.5 * (p[1] + best[1])]);
                corners[1] = half(second);
                half(worst)
            }
        };
    }
    corners.sort_by(|a, b| a.1.total_cmp(&b.1));
    corners[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_valley_is_followed_to_its_lowest_point_and_forbidden_places_are_not_taken() {
        let valley = |p: Place| {
            if p[0] > 1.3 { f64::INFINITY } else { (1.0 - p[0]).powi(2) + 10.0 * (p[1] - p[0] * p[0]).powi(2) }
        };
        let (place, value) = minimise([0.0, 0.0], 2.0, valley);
        assert!((place[0] - 1.0).abs() < 1e-3 && (place[1] - 1.0).abs() < 2e-3 && value < 1e-6, "{place:?} {value}");
        let (edge, _) =
            minimise([0.0, 0.0], 2.0, |p| if p[0] > 0.5 { f64::INFINITY } else { (p[0] - 1.0).powi(2) + p[1] * p[1] });
        assert!(edge[0] <= 0.5 && edge[0] > 0.45, "{edge:?}");
    }
}
