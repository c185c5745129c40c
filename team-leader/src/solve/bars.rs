//! Bars without a number: which is which, found by χ² (report 5.2.2; `MATHS.md` §5.2, "n bars").
//!
//! Problem: a bar that is missed doubles a gap, and one that is seen twice halves it; taken as they come, the bearings give a
//! wrong range with a small sigma. Insight: the near side of a circle shows n bearings for three unknowns, so all but one way
//! of numbering them fail by χ²(n − 3). Algorithm: every way with at most two bars missed or bearings too many is
//! fitted by Gauss–Newton on (range B, bearing β, turn w), from the closed form of its first, middle and last bar; each
//! missed bar and each bearing too many costs its odds. The cheapest stands only if it passes, and no other answer comes
//! near it. Three bearings have nothing left to check: they count where every other way would need a bar on the far side.
//!
//! ```text
//!   b_k = β + atan2(R sin ψ_k, B − R cos ψ_k)     ψ_k = w − κ_k, positive to the left     heading = β + π − w
//! ```

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix3, Vector3};
use protocol::angle::{difference, wrap};
use protocol::marker::Marker;
use protocol::marker::closed_form::three_bars;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::input::{Feature, Part, Problem, Sighting};

/// Bars missed between or beside those seen, and bearings too many, together at most.
const MOST_WRONG: usize = 2;
/// What each costs: one in a hundred, −2 ln p.
const WRONG_COST: f64 = 9.0;
/// Another answer must cost this much more, one in 400 at equal odds: so a single missed bar is always a rival.
const CLEAR_COST: f64 = 12.0;
/// The right way fails by chance once in a thousand.
const ACCEPTED: f64 = 0.999;
/// A bar nearer to the outline than this may go unseen without being missed, radians at the peer's axis.
const SLANT_RAD: f64 = 0.35;
/// Answers are the same within so many sigmas.
const SAME_SIGMAS: f64 = 3.0;
/// Most bearings of one sighting, and most bars round a body.
const MOST_BEARINGS: usize = 24;
const MOST_BARS: usize = 72;
const STEPS: usize = 8;

/// What bearings without numbers say.
#[derive(Debug, Clone, PartialEq)]
pub enum Numbering {
    /// Each bearing's bar; none where it is one too many.
    Numbered(Vec<Option<usize>>),
    /// The bars look the same from several sides: the axis alone, as (bearing, sigma) and (range, sigma).
    Turned([(f64, f64); 2]),
    /// Several ways fit, or none does.
    Open,
}

#[derive(Debug, Clone)]
struct Way {
    cost: f64,
    /// B, β, w.
    value: Vector3<f64>,
    covariance: Matrix3<f64>,
    bars: Vec<Option<usize>>,
}

/// Bars round a body from right to left, which is by falling azimuth.
struct Ring {
    /// Number in the announcement, and azimuth.
    bars: Vec<(usize, f64)>,
    /// So many bars on, the ring looks the same.
    period: usize,
    radius_m: f64,
}

/// Numbers bearings (with sigmas, radians, in any order) of bars at `azimuths_rad` round a body of `radius_m`, with the help of a
/// range (with sigma) where one is known.
pub fn number(bearings: &[(f64, f64)], range: Option<(f64, f64)>, azimuths_rad: &[f64], radius_m: f64) -> Numbering {
    if !(3..=MOST_BEARINGS).contains(&bearings.len()) || !(3..=MOST_BARS).contains(&azimuths_rad.len()) {
        return Numbering::Open;
    }
    let mut order: Vec<usize> = (0..bearings.len()).collect();
    order.sort_by(|a, b| {
        difference(bearings[*a].0, bearings[0].0).total_cmp(&difference(bearings[*b].0, bearings[0].0))
    });
    let sorted: Vec<(f64, f64)> = order.iter().map(|k| bearings[*k]).collect();
    let ring = Ring::new(azimuths_rad, radius_m);
    let mut ways = Vec::new();
    let mut bars = vec![None; sorted.len()];
    ring.each_way(0, None, 0, &mut bars, &mut |bars, wrong| {
        if let Some(way) = ring.fit(&sorted, range, bars, wrong) {
            ways.push(way);
        }
    });
    ways.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let Some(best) = ways.first() else { return Numbering::Open };
    let turn = TAU * ring.period as f64 / ring.bars.len() as f64;
    if ways.iter().any(|way| way.cost < best.cost + CLEAR_COST && way.differs(best, turn)) {
        return Numbering::Open;
    }
    if ring.period < ring.bars.len() {
        let sigma = |k: usize| best.covariance[(k, k)].max(0.0).sqrt();
        return Numbering::Turned([(wrap(best.value[1]), sigma(1)), (best.value[0], sigma(0))]);
    }
    let mut numbers = vec![None; bearings.len()];
    for (place, bar) in order.iter().zip(&best.bars) {
        numbers[*place] = bar.map(|place| ring.bars[place].0);
    }
    Numbering::Numbered(numbers)
}

impl Ring {
    fn new(azimuths_rad: &[f64], radius_m: f64) -> Self {
        let mut bars: Vec<(usize, f64)> =
            azimuths_rad.iter().enumerate().map(|(n, a)| (n, a.rem_euclid(TAU))).collect();
        bars.sort_by(|a, b| b.1.total_cmp(&a.1));
        let n = bars.len();
        let gap = |k: usize| (bars[k % n].1 - bars[(k + 1) % n].1).rem_euclid(TAU);
        let keeps = |turn: usize| (0..n).all(|k| (gap(k) - gap(k + turn)).abs() < 1e-6);
        let period = (1..n).find(|turn| n.is_multiple_of(*turn) && keeps(*turn)).unwrap_or(n);
        Self { bars, period, radius_m }
    }

    /// All ways to give bearings from number `from` on bars to the left of `last`, with `wrong` spent before.
    fn each_way(
        &self,
        from: usize,
        last: Option<usize>,
        wrong: usize,
        bars: &mut Vec<Option<usize>>,
        found: &mut impl FnMut(&[Option<usize>], usize),
    ) {
        if from == bars.len() {
            found(bars, wrong);
            return;
        }
        match last {
            None => {
                for first in 0..self.period {
                    bars[from] = Some(first);
                    self.each_way(from + 1, Some(first), wrong, bars, found);
                }
            }
            Some(last) => {
                for missed in 0..=MOST_WRONG - wrong {
                    // Counted on, not wrapped: so gaps add up.
                    bars[from] = Some(last + 1 + missed);
                    self.each_way(from + 1, Some(last + 1 + missed), wrong + missed, bars, found);
                }
            }
        }
        bars[from] = None;
        if wrong < MOST_WRONG {
            self.each_way(from + 1, last, wrong + 1, bars, found);
        }
    }

    /// Azimuth of a bar counted on over the seam, falling all the way.
    fn azimuth(&self, place: usize) -> f64 {
        let n = self.bars.len();
        self.bars[place % n].1 - TAU * (place / n) as f64
    }

    fn fit(
        &self,
        bearings: &[(f64, f64)],
        range: Option<(f64, f64)>,
        bars: &[Option<usize>],
        wrong: usize,
    ) -> Option<Way> {
        let radius = self.radius_m;
        // Bearing, sigma, azimuth.
        let seen: Vec<(f64, f64, f64)> =
            bearings.iter().zip(bars).filter_map(|((b, s), bar)| Some((*b, *s, self.azimuth((*bar)?)))).collect();
        let (first, middle, last) = (*seen.first()?, *seen.get(seen.len() / 2)?, *seen.last()?);
        if seen.len() < 3 || first.2 - last.2 >= PI {
            return None;
        }
        let start = three_bars([first.0, middle.0, last.0], middle.1, [first.2 - middle.2, middle.2 - last.2], radius)?;
        let mut value = Vector3::new(start.value[0], start.value[1], start.value[1] + PI - start.value[2] + middle.2);
        let (mut chi2, mut covariance) = (f64::INFINITY, Matrix3::identity());
        for _ in 0..STEPS {
            let (mut h, mut g, mut sum) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
            let mut add = |row: Vector3<f64>, rest: f64, sigma: f64| {
                let weight = 1.0 / (sigma * sigma);
                h += weight * row * row.transpose();
                g += weight * rest * row;
                sum += weight * rest * rest;
            };
            for (bearing, sigma, azimuth) in &seen {
                let (s, c) = (value[2] - azimuth).sin_cos();
                let away2 = value[0] * value[0] + radius * radius - 2.0 * value[0] * radius * c;
                let aside = (radius * s).atan2(value[0] - radius * c);
                let row = Vector3::new(-radius * s, away2, value[0] * radius * c - radius * radius) / away2;
                add(row, wrap(bearing - value[1] - aside), *sigma);
            }
            if let Some((range_m, sigma)) = range {
                add(Vector3::new(1.0, 0.0, 0.0), range_m - value[0], sigma);
            }
            covariance = h.try_inverse()?;
            let step = covariance * g;
            let is_settled = (step.transpose() * h * step)[0] < 1e-6;
            chi2 = sum;
            if is_settled {
                break;
            }
            value += step;
            if !(value[0] > 1.01 * radius && value[0] < 100.0) {
                return None;
            }
        }
        let dof = seen.len() + usize::from(range.is_some()) - 3;
        if dof > 0 && chi2 > ChiSquared::new(dof as f64).ok()?.inverse_cdf(ACCEPTED) {
            return None;
        }
        let limb = (radius / value[0]).acos();
        let turn_sigma = covariance[(2, 2)].max(0.0).sqrt();
        if seen.iter().any(|s| wrap(value[2] - s.2).abs() > limb.min(FRAC_PI_2) + SAME_SIGMAS * turn_sigma) {
            return None;
        }
        // Bars that should be seen beside those that are.
        let plain = (limb - SLANT_RAD - SAME_SIGMAS * turn_sigma).max(0.0);
        let (right, left) = (wrap(value[2] - first.2) - 1e-6, wrap(value[2] - last.2) + 1e-6);
        let beside = self.bars.iter().filter(|(_, azimuth)| {
            let psi = wrap(value[2] - azimuth);
            psi.abs() < plain && !(right..left).contains(&psi)
        });
        let cost = chi2 + WRONG_COST * (wrong + beside.count()) as f64;
        Some(Way { cost, value, covariance, bars: bars.iter().map(|b| b.map(|b| b % self.bars.len())).collect() })
    }
}

impl Way {
    /// Whether it says something else, turns by whole periods aside.
    fn differs(&self, other: &Self, turn: f64) -> bool {
        let mut away = self.value - other.value;
        away[1] = wrap(away[1]);
        away[2] -= turn * (away[2] / turn).round();
        (0..3).any(|k| {
            let sigma2 = self.covariance[(k, k)].max(other.covariance[(k, k)]).max(1e-12);
            away[k] * away[k] > SAME_SIGMAS * SAME_SIGMAS * sigma2
        })
    }
}

/// Numbers the bars of all sightings that have none; what could not be is left out, and said.
pub fn number_sightings(problem: &mut Problem) -> Vec<String> {
    let robots = &problem.robots;
    let mut said = Vec::new();
    problem.sightings.retain_mut(|sighting| {
        let unnumbered = |f: &&Feature| f.part == Part::UnnumberedBar;
        let bearings: Vec<(f64, f64)> =
            sighting.features.iter().filter(unnumbered).map(|f| (f.bearing_rad, f.sigma_rad)).collect();
        if bearings.is_empty() {
            return true;
        }
        let marker = sighting.peer.map(|peer| &robots[peer].marker);
        let numbering = match marker {
            Some(Marker::Bars { radius_m, azimuths_deg, .. }) => {
                let azimuths: Vec<f64> = azimuths_deg.iter().map(|a| a.to_radians()).collect();
                number(&bearings, sighting.range, &azimuths, *radius_m)
            }
            _ => Numbering::Open,
        };
        let of = || {
            let peer = sighting.peer.map_or("somebody", |peer| &robots[peer].id);
            format!("{} sees {} bars of {peer} without numbers", robots[sighting.observer].id, bearings.len())
        };
        match &numbering {
            Numbering::Numbered(numbers) if numbers.contains(&None) => {
                said.push(format!("{}: {} are none of its bars", of(), numbers.iter().filter(|n| n.is_none()).count()));
            }
            Numbering::Open => said.push(format!("{}: which they are is open, so they are not used", of())),
            _ => {}
        }
        take(sighting, &numbering);
        !sighting.features.is_empty() || sighting.bearing.is_some()
    });
    said
}

fn take(sighting: &mut Sighting, numbering: &Numbering) {
    let mut numbers = match numbering {
        Numbering::Numbered(numbers) => numbers.clone().into_iter(),
        _ => Vec::new().into_iter(),
    };
    sighting.features.retain_mut(|feature| {
        if feature.part != Part::UnnumberedBar {
            return true;
        }
        match numbers.next().flatten() {
            Some(n) => {
                feature.part = Part::Bar(n);
                true
            }
            None => false,
        }
    });
    if let Numbering::Turned([bearing, range]) = numbering {
        sighting.bearing = Some(*bearing);
        sighting.range = Some(*range);
    }
}

#[cfg(test)]
mod tests;
