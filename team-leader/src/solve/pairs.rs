//! Do the two directions of a pair agree? Two robots that see each other measure their distance twice, and each other's
//! heading where the markers show it: a wrong radius or a wrong name shows here, before anything is solved.

use std::collections::BTreeMap;

use protocol::angle::wrap;

use super::input::Problem;
use super::start::seen;

/// Sigmas beyond which a pair is named.
const DISAGREE_SIGMAS: f64 = 3.0;

#[derive(Debug, Clone, Copy, Default)]
struct Direction {
    range: Mean,
    bearing: Mean,
    heading: Mean,
}

/// Mean by inverse variance, about the first value.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    first: f64,
    weight: f64,
    sum: f64,
}

impl Mean {
    fn add(&mut self, value: f64, sigma: f64, angle: bool) {
        if self.weight == 0.0 {
            self.first = value;
        }
        let away = value - self.first;
        self.sum += if angle { wrap(away) } else { away } * sigma.powi(-2);
        self.weight += sigma.powi(-2);
    }

    fn value(&self) -> Option<(f64, f64)> {
        (self.weight > 0.0).then(|| (self.first + self.sum / self.weight, self.weight.recip()))
    }
}

/// Pairs whose directions are more than three sigmas apart, in words.
pub fn disagreements(problem: &Problem, placed: &[bool]) -> Vec<String> {
    let mut directions: BTreeMap<(usize, usize), Direction> = BTreeMap::new();
    for s in &problem.sightings {
        let Some(peer) = s.peer.filter(|p| placed[*p] && placed[s.observer]) else { continue };
        let Some((axis, heading)) = seen(problem, s, peer) else { continue };
        let direction = directions.entry((s.observer, peer)).or_default();
        direction.bearing.add(axis.bearing.0, axis.bearing.1, true);
        if let Some((range, sigma)) = axis.range {
            direction.range.add(range, sigma, false);
        }
        if let Some((heading, sigma)) = heading {
            direction.heading.add(heading, sigma, true);
        }
    }
    let mut found = Vec::new();
    for (&(i, j), there) in directions.iter().filter(|((i, j), _)| i < j) {
        let Some(back) = directions.get(&(j, i)) else { continue };
        let (a, b) = (&problem.robots[i].id, &problem.robots[j].id);
        if let (Some((x, vx)), Some((y, vy))) = (there.range.value(), back.range.value()) {
            let sigmas = (x - y).abs() / (vx + vy).sqrt();
            if sigmas > DISAGREE_SIGMAS {
                found.push(format!(
                    "{a} and {b} disagree: {a} sees {b} at {x:.3} m, {b} sees {a} at {y:.3} m, {sigmas:.1} sigmas apart (a wrong radius, or not each other?)"
                ));
            }
        }
        // What each shows of its heading, and what the two bearings say: h_j − h_i = β_ij − β_ji + π.
        let mutual = there.bearing.value().zip(back.bearing.value());
        let mutual = mutual.map(|((x, vx), (y, vy))| (wrap(x - y + std::f64::consts::PI), vx + vy));
        let shown = there.heading.value();
        let shown_back = back.heading.value().map(|(h, v)| (-h, v));
        for (one, two) in [(shown, mutual), (shown_back, mutual), (shown, shown_back)] {
            let (Some((x, vx)), Some((y, vy))) = (one, two) else { continue };
            let sigmas = wrap(x - y).abs() / (vx + vy).sqrt();
            if sigmas > DISAGREE_SIGMAS {
                found.push(format!(
                    "{a} and {b} disagree: their headings differ by {:.2}° one way and by {:.2}° the other, {sigmas:.1} sigmas apart",
                    wrap(x).to_degrees(),
                    wrap(y).to_degrees()
                ));
                break;
            }
        }
    }
    found
}
