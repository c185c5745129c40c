//! How likely it is that bearings without a name were paired wrongly, and what that costs.
//!
//! Beside the pairing that was taken there are others: two targets exchange the bearings of a robot (or of two), a bearing
//! belongs to another target that has none of that robot, or to none while a free one takes its place. All of them explain as
//! many bearings by as many targets, so that no density of targets or of clutter enters. A target may be anywhere, so the
//! likelihood of its bearings is an integral over the room, taken about the best place (Laplace):
//!
//! ```text
//!   S = −½ χ² − Σ ln σᵢ + ½ ln |P|        P(other pairing) = exp ΔS / (1 + Σ exp ΔS)
//! ```

use nalgebra::{Matrix3, Vector2, Vector3};
use protocol::angle::wrap;

use super::input::{Bearing, Problem};

/// Steps of Gauss and Newton.
const STEPS: usize = 8;
/// Farthest target, metres.
const FAR_M: f64 = 100.0;
/// A robot is no nearer to a target, metres.
const NEAR_M: f64 = 0.05;
/// Less likely pairings are left out, nats.
const HOPELESS: f64 = -30.0;
/// Of more robots only exchanges of one robot's bearings are looked at.
const MOST_FOR_TWO: usize = 8;

/// Doubt about a target's bearings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Doubt {
    /// That some of them are another's.
    pub probability: f64,
    /// Expected square of the error that comes of it, m².
    pub square_m2: f64,
}

/// Poses (x, y, heading) of the robots, with sigmas of position and heading.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// The poses.
    pub poses: &'a [[f64; 3]],
    /// The sigmas.
    pub sigmas: &'a [(f64, f64)],
}

/// Of every target; nothing for those whose bearings the file named.
pub fn doubts(problem: &Problem, known: Known<'_>) -> Vec<Option<Doubt>> {
    let targets = problem.targets.len();
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); targets];
    let mut named = vec![false; targets];
    let mut free: Vec<usize> = Vec::new();
    for (b, bearing) in problem.bearings.iter().enumerate() {
        let paired = problem.paired.get(b).copied().unwrap_or(false);
        match bearing.target {
            Some(t) => {
                members[t].push(b);
                named[t] |= !paired;
            }
            None => free.push(b),
        }
    }
    let room = Room { problem, known };
    let fits: Vec<Option<Fit>> = (0..targets).map(|t| if named[t] { None } else { room.fit(&members[t]) }).collect();
    (0..targets).map(|t| Some(room.doubt(t, &members, &fits, &free, fits[t]?))).collect()
}

/// A target placed by some bearings.
#[derive(Debug, Clone, Copy)]
struct Fit {
    at: Vector3<f64>,
    score: f64,
}

struct Room<'a> {
    problem: &'a Problem,
    known: Known<'a>,
}

impl Room<'_> {
    fn bearing(&self, b: usize) -> &Bearing {
        &self.problem.bearings[b]
    }

    fn doubt(&self, t: usize, members: &[Vec<usize>], fits: &[Option<Fit>], free: &[usize], fit: Fit) -> Doubt {
        let mut others: Vec<(f64, f64)> = Vec::new();
        let mine = &members[t];
        let mut consider = |new: &[usize], rival: Option<(f64, &[usize])>| {
            let Some(there) = self.fit(new) else { return };
            let Some((before, after)) =
                rival.map_or(Some((0.0, 0.0)), |(score, of)| Some((score, self.fit(of)?.score)))
            else {
                return;
            };
            let gain = there.score + after - fit.score - before;
            if gain > HOPELESS {
                others.push((gain, (there.at - fit.at).xy().norm_squared()));
            }
        };
        for &b in free {
            if let Some(place) = mine.iter().position(|m| self.alike(*m, b)) {
                let mut new = mine.clone();
                new[place] = b;
                consider(&new, None);
            }
        }
        for (theirs, rival) in members.iter().zip(fits).enumerate().filter(|(u, _)| *u != t).map(|(_, of)| of) {
            let Some(rival) = rival else { continue };
            for taken in self.exchanges(mine, theirs) {
                let (new, left) = exchanged(mine, theirs, &taken);
                consider(&new, Some((rival.score, &left)));
            }
        }
        // Sums relative to the likeliest, which is the one that was taken or a little more.
        let most = others.iter().map(|(gain, _)| *gain).fold(0.0, f64::max);
        let all = (-most).exp() + others.iter().map(|(gain, _)| (gain - most).exp()).sum::<f64>();
        others.iter().fold(Doubt::default(), |sum, (gain, square)| {
            let p = (gain - most).exp() / all;
            Doubt { probability: sum.probability + p, square_m2: sum.square_m2 + p * square }
        })
    }

    /// Of one robot at one time.
    fn alike(&self, a: usize, b: usize) -> bool {
        let (a, b) = (self.bearing(a), self.bearing(b));
        a.observer == b.observer && a.is_together(b)
    }

    /// Which bearings two targets may exchange: of each robot or of two robots, where each keeps two and one more than it gives.
    fn exchanges(&self, mine: &[usize], theirs: &[usize]) -> Vec<Vec<usize>> {
        if !mine.iter().zip(theirs).all(|(a, b)| self.bearing(*a).is_together(self.bearing(*b))) {
            return Vec::new();
        }
        let mut robots: Vec<usize> = mine.iter().chain(theirs).map(|b| self.bearing(*b).observer).collect();
        robots.sort_unstable();
        robots.dedup();
        let of = |robots: &[usize]| -> Vec<usize> {
            let all = mine.iter().chain(theirs);
            all.filter(|b| robots.contains(&self.bearing(**b).observer)).copied().collect()
        };
        let mut choices: Vec<Vec<usize>> = robots.iter().map(|r| of(&[*r])).collect();
        if robots.len() == 2 || robots.len() > MOST_FOR_TWO {
            // Of two robots either's exchange is the same.
            choices.truncate(if robots.len() == 2 { 1 } else { robots.len() });
            return choices;
        }
        for (n, a) in robots.iter().enumerate() {
            // Of four robots two against two is the same as the other two.
            let others = robots[n + 1..].iter().filter(|_| robots.len() > 4 || (robots.len() == 4 && n == 0));
            choices.extend(others.map(|b| of(&[*a, *b])));
        }
        choices
    }

    /// The place that explains some bearings best, and how well.
    fn fit(&self, members: &[usize]) -> Option<Fit> {
        let mut at = self.crossing(members)?;
        let rises = members.iter().any(|b| self.bearing(*b).elevation.is_some());
        let mut fit = None;
        for _ in 0..STEPS {
            let mut information = Matrix3::zeros();
            let mut gradient = Vector3::zeros();
            let mut score = 0.0;
            let mut add = |row: Vector3<f64>, residual: f64, var: f64| {
                information += row * row.transpose() / var;
                gradient += row * residual / var;
                score -= 0.5 * (residual * residual / var + var.ln());
            };
            for b in members {
                let bearing = self.bearing(*b);
                let ([x, y, heading], (place, turn)) =
                    (self.known.poses[bearing.observer], self.known.sigmas[bearing.observer]);
                let away = at.xy() - Vector2::new(x, y);
                let range = away.norm();
                let residual = wrap(bearing.bearing.0 + heading - away.y.atan2(away.x));
                if !(NEAR_M..FAR_M).contains(&range) || residual.abs() > 1.0 {
                    return None;
                }
                let across = Vector3::new(-away.y, away.x, 0.0) / (range * range);
                add(across, residual, bearing.bearing.1.powi(2) + turn * turn + (place / range).powi(2));
                if let Some((elevation, sigma)) = bearing.elevation {
                    let rise = at.z - self.problem.robots[bearing.observer].camera_height_m;
                    let d2 = rise * rise + range * range;
                    let row = Vector3::new(-rise * away.x / range / d2, -rise * away.y / range / d2, range / d2);
                    add(row, elevation - rise.atan2(range), sigma * sigma);
                }
            }
            if !rises {
                information[(2, 2)] = 1.0;
            }
            let covariance = information.try_inverse()?;
            fit = Some(Fit { at, score: score + 0.5 * covariance.determinant().max(f64::MIN_POSITIVE).ln() });
            at += covariance * gradient;
        }
        fit
    }

    /// Where two of the rays meet that meet at the largest angle, at the height that the first elevation gives.
    fn crossing(&self, members: &[usize]) -> Option<Vector3<f64>> {
        let ray = |b: usize| {
            let [x, y, heading] = self.known.poses[self.bearing(b).observer];
            let (sin, cos) = (heading + self.bearing(b).bearing.0).sin_cos();
            (Vector2::new(x, y), Vector2::new(cos, sin))
        };
        let mut best: Option<(f64, Vector2<f64>)> = None;
        for (n, a) in members.iter().enumerate() {
            for b in &members[n + 1..] {
                let ((p, d), (q, e)) = (ray(*a), ray(*b));
                let sine = d.perp(&e);
                let (s, t) = ((q - p).perp(&e) / sine, (q - p).perp(&d) / sine);
                if sine.abs() > best.map_or(0.02, |(sine, _)| sine) && s > NEAR_M && t > NEAR_M && s < FAR_M {
                    best = Some((sine.abs(), p + d * s));
                }
            }
        }
        let (_, at) = best?;
        let height = members.iter().find_map(|b| {
            let bearing = self.bearing(*b);
            let [x, y, _] = self.known.poses[bearing.observer];
            let range = (at - Vector2::new(x, y)).norm();
            Some(self.problem.robots[bearing.observer].camera_height_m + range * bearing.elevation?.0.tan())
        });
        Some(Vector3::new(at.x, at.y, height.unwrap_or(0.0)))
    }
}

/// Two targets after an exchange of the bearings in `taken`.
fn exchanged(mine: &[usize], theirs: &[usize], taken: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let pick = |keep: &[usize], give: &[usize]| -> Vec<usize> {
        let kept = keep.iter().filter(|b| !taken.contains(b));
        kept.chain(give.iter().filter(|b| taken.contains(b))).copied().collect()
    };
    (pick(mine, theirs), pick(theirs, mine))
}

#[cfg(test)]
mod tests;
