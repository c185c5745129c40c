//! Which bars a painted body shows: who it is, which way it looks, and where each bar is.
//!
//! Problem: bars are a few pixels wide, some are hidden, a lamp makes one side darker than the other, and a fellow may wear
//! bars that look alike from most sides. Insight: in a bar the rings are the other way round, so every picture column has a
//! signed amplitude of the rings, +1 on the ground and −1 in a bar times the light, whatever the lamps do. Algorithm: the
//! amplitudes of all columns are compared at once with what each known pattern shows at each heading (the light is a free
//! parabola over the body), and the best is refined by Gauss–Newton; the heading stands only if no other heading of the
//! pattern fits nearly as well, and the name only if no other pattern does. A missed or doubled bar is no special case: it
//! is a few columns that do not fit, and too many of them (χ²) make it no reading. Then each bar is let go by itself, and
//! where it comes to rest is its raw measurement (report 5.2.2; `MATHS.md` §5.2).

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::blur;
use super::geometry::is_within;
use super::look::{CylinderLook, MAX_RINGS, Pattern};
use super::rays::Sample;
use super::rings::{self, RingFit, median};

/// Step of the coarse search for the heading.
const HEADING_STEP_RAD: f64 = 0.0436;
/// Bars are read this far round the body: sine of the angle of incidence.
const MOST_SINE: f64 = 0.95;
/// A bar is whole whose outer border is seen at no larger sine of the angle of incidence.
const WHOLE_SINE: f64 = 0.9;
/// Most columns over a body.
const MOST_COLUMNS: f64 = 96.0;
/// Paint, blur and light are as the model says to this share of the amplitude.
const MODEL_SHARE: f64 = 0.08;
/// A column costs no more than this, whatever it shows: somebody may stand before it.
const MOST_COST: f64 = 16.0;
/// A mean cost of a column above which the pattern is not there.
const WORST_MEAN_COST: f64 = 5.0;
/// The same above which a name or a heading is not believed.
const WORST_NAMED_COST: f64 = 3.0;
/// The same where the marker's upper end is all that shows a body. In 40 rooms 50 true ones stayed below 0.86; legs, shelves and
/// table tops, of which one even had an outline, were at 1 to 5.
const WORST_RIM_COST: f64 = 1.2;
/// Of a body of which the upper end was fitted alone, half of the columns with rings in view, if there are so many, correlate with
/// them like this.
const LEAST_RINGED: usize = 8;
const LEAST_RINGED_CORRELATION: f64 = 0.6;
/// A reading so good whose rivals cost this much more is of bars and nothing else.
const WORST_CERTAIN: f64 = 2.5;
const CERTAIN_COST: f64 = 60.0;
/// Another reading must cost this much more for the best to stand (one in e⁶ at equal odds).
const CLEAR_COST: f64 = 12.0;
/// The same where only one ring is in view.
const SINGLE_RING_COST: f64 = 60.0;
/// Priors of the light over the body, shares of its level: level, slope, bend.
const LIGHT_SIGMA: [f64; 3] = [0.5, 0.5, 0.35];
/// A bar is measured by itself where its noise is below this.
const WORST_BAR_PX: f64 = 0.5;
/// A bar that comes to rest further from the common heading than this many sigmas is no bar of the pattern.
const BAR_GATE: f64 = 4.0;

/// What the bars say.
#[derive(Debug, Clone)]
pub struct Reading {
    /// Which of the look's patterns.
    pub pattern: usize,
    /// Whether no other pattern fits nearly as well.
    pub is_named: bool,
    /// Of the peer in the observer's body frame, and its standard deviation.
    pub heading_rad: [f64; 2],
    /// Whether no other heading fits nearly as well.
    pub has_heading: bool,
    /// Whether the bars are where they seem to be: no other heading fits nearly as well but those that look the same, and no other
    /// pattern.
    pub is_clear: bool,
    /// What does not fit, a column of the body: 1 is noise.
    pub misfit: f64,
    /// Half of the columns in which rings are in view correlate with them at least like this; 1 where there are too few to say.
    pub ringed: f64,
    /// Whether it is bars beyond all doubt: every other pattern fits worse by far.
    pub is_certain: bool,
    /// Bars that are measured by themselves, right to left.
    pub bars: Vec<BarSight>,
    /// Ground and bars over the body.
    pub signal: Signal,
}

/// One bar.
#[derive(Debug, Clone, Copy)]
pub struct BarSight {
    /// In the pattern.
    pub bar: usize,
    /// Of its middle, observer's body frame.
    pub bearing_rad: f64,
    /// From noise.
    pub sigma_rad: f64,
    /// Pixels per radian there.
    pub px_per_rad: f64,
    /// Both of its borders are in view. Of another one only the inner border is measured: its middle follows the body's bearing, as the
    /// rings have it, and says nothing of that.
    pub is_whole: bool,
}

impl Reading {
    /// Those bars that say where the body is.
    pub fn whole_bars(&self) -> impl Iterator<Item = &BarSight> {
        self.bars.iter().filter(|bar| bar.is_whole)
    }
}

/// +1 on the ground, −1 in bars, over bearings less the axis' bearing.
#[derive(Debug, Clone, Default)]
pub struct Signal {
    /// Right and left border of each bar in view, radians.
    borders: Vec<[f64; 2]>,
}

impl Signal {
    /// Through a blur (standard deviation, radians).
    pub fn at(&self, aside_rad: f64, blur_rad: f64) -> f64 {
        let step = |border: f64| blur::step((aside_rad - border) / blur_rad);
        1.0 - 2.0 * self.borders.iter().map(|[right, left]| step(*right) - step(*left)).sum::<f64>()
    }
}

/// One picture column of the body.
struct Column {
    aside_rad: f64,
    /// Of the axis' nearest line 0, of the outlines ±1.
    sine: f64,
    amplitude: f64,
    variance: f64,
    /// Of its pixels with the rings, 0 … 1.
    correlation: f64,
    /// What the column shows of a signal: base + swing · signal.
    shown: [f64; 2],
    blur_rad: f64,
    px_per_rad: f64,
}

struct Geometry {
    bearing_rad: f64,
    range_m: f64,
    radius_m: f64,
}

impl Geometry {
    /// Bearing less the axis' of a point at the angle ψ (at the peer's axis from the observer, positive to the left).
    fn aside(&self, psi: f64) -> f64 {
        (self.radius_m * psi.sin()).atan2(self.range_m - self.radius_m * psi.cos())
    }

    /// ψ of the outlines.
    fn limb(&self) -> f64 {
        (self.radius_m / self.range_m).clamp(0.0, 1.0).acos()
    }

    /// ψ of a bar of the body at an azimuth, when the peer's heading is `heading`.
    fn psi(&self, azimuth: f64, heading: f64) -> f64 {
        protocol::angle::wrap(self.bearing_rad + PI - azimuth - heading)
    }

    /// The bars in view.
    fn signal(&self, pattern: &Pattern, heading: f64, moved: Option<(usize, f64)>) -> Signal {
        let limb = self.limb();
        let mut borders = Vec::new();
        for (n, bar) in pattern.bars.iter().enumerate() {
            let extra = moved.filter(|(m, _)| *m == n).map_or(0.0, |(_, by)| by);
            let psi = self.psi(bar.azimuth_rad, heading) + extra;
            let (right, left) = (psi - bar.half_width_rad, psi + bar.half_width_rad);
            // A wide bar may come round both limbs.
            for turn in [-TAU, 0.0, TAU] {
                let (right, left) = (right + turn, left + turn);
                if left.min(limb) > right.max(-limb) {
                    // What comes round the limb goes on as far as the outline is seen.
                    let right = if right > -limb { self.aside(right) } else { f64::NEG_INFINITY };
                    let left = if left < limb { self.aside(left) } else { f64::INFINITY };
                    borders.push([right, left]);
                }
            }
        }
        Signal { borders }
    }
}

struct Hypothesis {
    pattern: usize,
    heading: f64,
    cost: f64,
}

/// Reads the bars of a body whose rings were fitted. `noise2` is the sensor's. `None` where no known pattern is to be seen.
pub fn read(
    samples: &[Sample],
    look: &CylinderLook,
    rings: &RingFit,
    noise2: f64,
    hidden: &[[f64; 2]],
) -> Option<Reading> {
    let geometry =
        Geometry { bearing_rad: rings.bearing_rad, range_m: rings.near_m + look.radius_m, radius_m: look.radius_m };
    let columns = columns(samples, look, rings, noise2, hidden);
    if columns.len() < 4 {
        return None;
    }
    let mut sizes: Vec<f64> =
        columns.iter().map(|c| c.amplitude.abs() / (c.shown[0].abs() + c.shown[1].abs()).max(1e-3)).collect();
    sizes.sort_by(f64::total_cmp);
    let level = sizes[sizes.len() * 3 / 4];
    // Where rings were not fitted the columns in which some are in view must show them.
    let mut ringed: Vec<f64> = columns.iter().filter(|c| c.shown[0] == 0.0).map(|c| c.correlation).collect();
    let ringed = if ringed.len() < LEAST_RINGED { 1.0 } else { median(&mut ringed) };
    if rings.end.is_some() && ringed < LEAST_RINGED_CORRELATION {
        return None;
    }
    let coarse = Coarse::new(&columns, &geometry);
    let mut best: Vec<Hypothesis> = Vec::new();
    let mut rival_heading = f64::INFINITY;
    // The coarse costs are rough, and of a share of the columns only.
    let slack = 14.0 * CLEAR_COST;
    let coarse = look
        .patterns
        .iter()
        .map(|pattern| {
            let steps = (pattern.period_rad / HEADING_STEP_RAD).ceil().max(1.0) as usize;
            let step = pattern.period_rad / steps as f64;
            let costs = coarse.costs(pattern, if pattern.bars.is_empty() { 1 } else { steps }, step, level);
            (step, costs)
        })
        .collect::<Vec<_>>();
    let least = coarse.iter().flat_map(|(_, costs)| costs).copied().fold(f64::INFINITY, f64::min);
    for (n, (pattern, (step, costs))) in look.patterns.iter().zip(&coarse).enumerate() {
        let first = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
        if costs[first] > least + slack {
            continue;
        }
        let refined = refine(&columns, &geometry, pattern, first as f64 * step, level);
        // The best of the valleys that lie elsewhere.
        let apart = |i: usize| {
            let away = (i + costs.len() - first) % costs.len();
            away.min(costs.len() - away) as f64 * step > pattern.narrowest_rad
        };
        let valley = (0..costs.len()).filter(|i| apart(*i)).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        let other = valley.map_or(f64::INFINITY, |i| {
            if costs[i] < costs[first] + slack {
                refine(&columns, &geometry, pattern, i as f64 * step, level).1
            } else {
                f64::INFINITY
            }
        });
        if best.first().is_none_or(|b| refined.1 < b.cost) {
            rival_heading = other;
        }
        best.push(Hypothesis { pattern: n, heading: refined.0, cost: refined.1 });
        best.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    }
    let chosen = best.first()?;
    let worst = if rings.end.is_some() { WORST_RIM_COST } else { WORST_MEAN_COST };
    if chosen.cost > worst * columns.len() as f64 {
        return None;
    }
    let pattern = &look.patterns[chosen.pattern];
    // A single ring is told from its negative by brightness alone, which shadows change, too.
    let single = columns.iter().filter(|c| c.shown[0] > 0.0).count();
    let clear = if 2 * single > columns.len() { SINGLE_RING_COST } else { CLEAR_COST };
    let is_named = chosen.cost <= WORST_NAMED_COST * columns.len() as f64
        && best.get(1).is_none_or(|second| second.cost > chosen.cost + clear);
    // A reading that another pattern of the same kind contests has no heading either.
    let is_clear = is_named && rival_heading > chosen.cost + clear;
    let has_heading = is_clear && !pattern.bars.is_empty() && pattern.period_rad > 0.99 * TAU;
    let signal = geometry.signal(pattern, chosen.heading, None);
    let (bars, sigma) = each_bar(&columns, &geometry, pattern, chosen.heading, level, rings);
    let heading_rad = [protocol::angle::wrap(chosen.heading), sigma];
    let misfit = chosen.cost / columns.len() as f64;
    let is_certain = look.patterns.len() > 1
        && !pattern.bars.is_empty()
        && misfit < WORST_CERTAIN
        && best.get(1).is_none_or(|second| second.cost > chosen.cost + CERTAIN_COST);
    Some(Reading {
        pattern: chosen.pattern,
        is_named,
        heading_rad,
        has_heading,
        is_clear,
        misfit,
        ringed,
        is_certain,
        bars,
        signal,
    })
}

/// A few columns, each with the azimuths at the peer's axis that it shows, for the search over all headings.
struct Coarse<'a> {
    columns: Vec<&'a Column>,
    /// Azimuth plus heading, in steps of a turn, at three places of the column.
    azimuths: Vec<[usize; 3]>,
}

/// Steps of a turn in [`Coarse`].
const TURN_STEPS: usize = 1440;
/// Most columns of the coarse search.
const COARSE_COLUMNS: usize = 32;

impl<'a> Coarse<'a> {
    fn new(columns: &'a [Column], geometry: &Geometry) -> Self {
        let every = columns.len().div_ceil(COARSE_COLUMNS);
        let columns: Vec<&Column> = columns.iter().step_by(every).collect();
        let azimuth = |aside: f64| {
            let sine = (geometry.range_m * aside.sin() / geometry.radius_m).clamp(-1.0, 1.0);
            let psi = sine.asin() - aside;
            let turns = (geometry.bearing_rad + PI - psi).rem_euclid(TAU) / TAU;
            ((turns * TURN_STEPS as f64) as usize).min(TURN_STEPS - 1)
        };
        let azimuths =
            columns.iter().map(|c| [-1.2, 0.0, 1.2].map(|k| azimuth(c.aside_rad + k * c.blur_rad))).collect();
        Self { columns, azimuths }
    }

    /// The cost of each of so many headings.
    fn costs(&self, pattern: &Pattern, headings: usize, step_rad: f64, level: f64) -> Vec<f64> {
        let sign: Vec<f64> = (0..TURN_STEPS)
            .map(|n| {
                let azimuth = (n as f64 + 0.5) / TURN_STEPS as f64 * TAU;
                let in_bar = pattern
                    .bars
                    .iter()
                    .any(|bar| protocol::angle::difference(azimuth, bar.azimuth_rad).abs() < bar.half_width_rad);
                if in_bar { -1.0 } else { 1.0 }
            })
            .collect();
        let mut shown = vec![0.0; self.columns.len()];
        let columns = || self.columns.iter().copied();
        (0..headings)
            .map(|i| {
                let turned = (i as f64 * step_rad / TAU * TURN_STEPS as f64) as usize;
                for ((shown, azimuths), column) in shown.iter_mut().zip(&self.azimuths).zip(&self.columns) {
                    let at = |azimuth: usize| sign[(azimuth + TURN_STEPS - turned) % TURN_STEPS];
                    let signal = 0.25 * at(azimuths[0]) + 0.5 * at(azimuths[1]) + 0.25 * at(azimuths[2]);
                    *shown = column.shown[0] + column.shown[1] * signal;
                }
                light(columns(), &shown, level).1
            })
            .collect()
    }
}

/// The rings' signed amplitude in each column of the body.
fn columns(samples: &[Sample], look: &CylinderLook, rings: &RingFit, noise2: f64, hidden: &[[f64; 2]]) -> Vec<Column> {
    let cylinder = rings.cylinder(look.radius_m);
    let half = cylinder.outline_rad;
    let scale = samples.first().map_or(200.0, |s| f64::from(s.ray.px_per_bearing));
    let wide = (1.0 / scale).max(2.0 * half / MOST_COLUMNS);
    let count = (2.0 * half / wide).ceil().max(1.0) as usize;
    // n, p, pp, g, pg, gg, sine, pixels per radian, and pp-weighted place.
    let mut sums = vec![[0.0f64; 9]; count];
    let mut by_ring = [0.0; MAX_RINGS];
    let middle = look.middle_reflectance();
    for sample in samples {
        let met = cylinder.meet(&sample.ray);
        if met.sine.abs() > MOST_SINE {
            continue;
        }
        let blur_m = rings.blur_px * sample.ray.m_per_px(met.distance_m);
        let height = met.height_m + rings.lower_m;
        if height < look.low_m() + 2.0 * blur_m || height > look.high_m() - 2.0 * blur_m {
            continue;
        }
        let bearing = f64::from(sample.ray.bearing_rad);
        if hidden.iter().any(|sector| is_within(*sector, bearing)) {
            continue;
        }
        let p = rings::profile(look, &rings.reflectance, height, blur_m, &mut by_ring) - middle;
        let column = (((met.aside_rad + half) / wide) as usize).min(count - 1);
        let g = sample.gray;
        let entries =
            [1.0, p, p * p, g, p * g, g * g, met.sine, f64::from(sample.ray.px_per_bearing), p * p * met.aside_rad];
        sums[column].iter_mut().zip(entries).for_each(|(sum, entry)| *sum += entry);
    }
    let mut columns = Vec::new();
    let mut rests = Vec::new();
    for [n, p, pp, g, pg, gg, sine, px, place] in sums {
        let (vpp, vpg, vgg) = (pp - p * p / n, pg - p * g / n, gg - g * g / n);
        if n < 4.0 {
            continue;
        }
        let px_per_rad = px / n;
        let blur_px = rings.blur_px.hypot(0.29 * wide * px_per_rad);
        let mut column = Column {
            // Where its pixels are, not where the column is: few rows need not lie evenly.
            aside_rad: place / pp.max(1e-12),
            sine: sine / n,
            amplitude: 0.0,
            variance: 0.0,
            correlation: 0.0,
            shown: [0.0, 1.0],
            blur_rad: blur_px / px_per_rad,
            px_per_rad,
        };
        let least2 = rings.noise * rings.noise;
        if vpp >= 2e-3 * n {
            let rest2 = (vgg - vpg * vpg / vpp).max(0.0) / (n - 2.0);
            rests.push(rest2.sqrt());
            column.amplitude = vpg / vpp;
            column.correlation = rings::correlation([vpp, vpg, vgg], n, noise2).abs();
            column.variance = rest2.max(least2) / vpp;
        } else {
            // One ring alone is in view: then it is bright or dark by itself.
            let rest2 = vgg.max(0.0) / (n - 1.0);
            rests.push(rest2.sqrt());
            column.amplitude = g / n;
            column.variance = rest2.max(least2) / n;
            column.shown = [middle, p / n];
        }
        columns.push(column);
    }
    // A column that somebody touches fits worse than its fellows.
    let typical = median(&mut rests.clone());
    let mut rests = rests.into_iter();
    columns.retain(|_| rests.next().is_some_and(|rest| rest <= 3.5 * typical.max(rings.noise)));
    columns
}

fn signals(columns: &[Column], signal: &Signal) -> Vec<f64> {
    columns.iter().map(|c| c.shown[0] + c.shown[1] * signal.at(c.aside_rad, c.blur_rad)).collect()
}

/// Light over the body for a signal: its parabola and what is left, priors included.
fn light<'a>(columns: impl Iterator<Item = &'a Column> + Clone, signal: &[f64], level: f64) -> (Vector3<f64>, f64) {
    let mut h = Matrix3::zeros();
    let mut g = Vector3::zeros();
    let model2 = (MODEL_SHARE * level).powi(2);
    // Even light first: how bright it is depends on what is shown.
    let (sa, ss) = columns.clone().zip(signal).fold((0.0, 0.0), |(sa, ss), (c, s)| {
        let weight = 1.0 / (c.variance + model2);
        (sa + weight * s * c.amplitude, ss + weight * s * s)
    });
    let level = (sa / f64::max(ss, 1e-12)).max(0.2 * level);
    let mean = Vector3::new(level, 0.0, 0.0);
    for k in 0..3 {
        let weight = 1.0 / (LIGHT_SIGMA[k] * level).powi(2).max(1e-12);
        h[(k, k)] += weight;
        g[k] += weight * mean[k];
    }
    for (c, s) in columns.clone().zip(signal) {
        let row = Vector3::new(*s, s * c.sine, s * c.sine * c.sine);
        let weight = 1.0 / (c.variance + model2);
        h += weight * row * row.transpose();
        g += weight * c.amplitude * row;
    }
    let Some(inverse) = h.try_inverse() else { return (mean, f64::INFINITY) };
    let a = inverse * g;
    let mut cost: f64 = (0..3).map(|k| ((a[k] - mean[k]) / (LIGHT_SIGMA[k] * level)).powi(2)).sum();
    for (c, s) in columns.zip(signal) {
        let shown = s * (a[0] + a[1] * c.sine + a[2] * c.sine * c.sine);
        cost += ((c.amplitude - shown).powi(2) / (c.variance + model2)).min(MOST_COST);
    }
    (a, cost)
}

/// The heading of least cost near a start, and that cost.
fn refine(columns: &[Column], geometry: &Geometry, pattern: &Pattern, start: f64, level: f64) -> (f64, f64) {
    let cost =
        |heading: f64| light(columns.iter(), &signals(columns, &geometry.signal(pattern, heading, None)), level).1;
    if pattern.bars.is_empty() {
        return (start, cost(start));
    }
    // The cost is smooth and its valley wider than a step: shrinking brackets.
    let (mut middle, mut reach) = (start, 0.6 * HEADING_STEP_RAD);
    let mut least = cost(middle);
    for _ in 0..9 {
        for side in [middle - reach, middle + reach] {
            let there = cost(side);
            if there < least {
                (middle, least) = (side, there);
            }
        }
        reach *= 0.6;
    }
    (middle, least)
}

/// Each bar let go by itself beside the light; and the standard deviation of the common heading.
fn each_bar(
    columns: &[Column],
    geometry: &Geometry,
    pattern: &Pattern,
    heading: f64,
    level: f64,
    rings: &RingFit,
) -> (Vec<BarSight>, f64) {
    const STEP: f64 = 2e-3;
    let limb = geometry.limb();
    let is_within_limb = |n: &usize| {
        let bar = &pattern.bars[*n];
        let psi = geometry.psi(bar.azimuth_rad, heading);
        psi.abs() + bar.half_width_rad < limb.min(1.3)
    };
    let bars: Vec<usize> = (0..pattern.bars.len()).filter(is_within_limb).collect();
    let here = signals(columns, &geometry.signal(pattern, heading, None));
    let (a, _) = light(columns.iter(), &here, level);
    let by = |signal: Signal| -> Vec<f64> {
        signals(columns, &signal).iter().zip(&here).map(|(there, here)| (there - here) / STEP).collect()
    };
    let turned = by(geometry.signal(pattern, heading + STEP, None));
    let slopes: Vec<Vec<f64>> = bars.iter().map(|n| by(geometry.signal(pattern, heading, Some((*n, STEP))))).collect();
    let m = 3 + bars.len();
    let mut h = DMatrix::<f64>::zeros(m, m);
    let mut g = DVector::<f64>::zeros(m);
    for k in 0..3 {
        h[(k, k)] += 1.0 / (LIGHT_SIGMA[k] * level).powi(2).max(1e-12);
    }
    let (mut turn_information, mut chi2, mut n) = (0.0, 0.0, 0.0);
    // Beside noise, the model is right to a smaller share where a bar's border is than anywhere: it is a matter of place.
    let model2 = (0.5 * MODEL_SHARE * level).powi(2);
    for (i, c) in columns.iter().enumerate() {
        let light = a[0] + a[1] * c.sine + a[2] * c.sine * c.sine;
        let rest = c.amplitude - here[i] * light;
        let weight = 1.0 / (c.variance + model2);
        if rest * rest * weight > 2.0 * MOST_COST {
            continue;
        }
        let mut row = vec![here[i], here[i] * c.sine, here[i] * c.sine * c.sine];
        row.extend(slopes.iter().map(|slope| light * slope[i]));
        for p in 0..m {
            for q in 0..m {
                h[(p, q)] += weight * row[p] * row[q];
            }
            g[p] += weight * row[p] * rest;
        }
        turn_information += weight * (light * turned[i]).powi(2);
        chi2 += weight * rest * rest;
        n += 1.0;
    }
    let inflate = (chi2 / f64::max(n - 4.0, 1.0)).max(1.0);
    let sigma = (inflate / f64::max(turn_information, 1e-6)).sqrt();
    for k in 3..m {
        // A bar in no column stays where it is, and says so.
        h[(k, k)] += 1.0;
    }
    let Some(factor) = h.cholesky() else { return (Vec::new(), sigma) };
    let (delta, inverse) = (factor.solve(&g), factor.inverse());
    let mut sights: Vec<BarSight> = Vec::new();
    for (k, bar) in bars.iter().enumerate() {
        let psi = geometry.psi(pattern.bars[*bar].azimuth_rad, heading);
        let (moved, psi_sigma) = (delta[3 + k], (inverse[(3 + k, 3 + k)] * inflate).sqrt());
        let stretch = (geometry.aside(psi + 1e-4) - geometry.aside(psi - 1e-4)) / 2e-4;
        let px_per_rad = nearest(columns, geometry.aside(psi)).map_or(200.0, |c| c.px_per_rad);
        let sigma_rad = stretch.abs() * psi_sigma;
        let fine = sigma_rad * px_per_rad < WORST_BAR_PX && moved.abs() < BAR_GATE * psi_sigma.hypot(sigma) + 0.01;
        if fine {
            let bearing_rad = protocol::angle::wrap(rings.bearing_rad + geometry.aside(psi + moved));
            let border = psi.abs() + pattern.bars[*bar].half_width_rad;
            let is_whole = (border + geometry.aside(border)).sin() < WHOLE_SINE;
            sights.push(BarSight { bar: *bar, bearing_rad, sigma_rad, px_per_rad, is_whole });
        }
    }
    sights.sort_by(|a, b| {
        let aside = |s: &BarSight| protocol::angle::difference(s.bearing_rad, rings.bearing_rad);
        aside(a).total_cmp(&aside(b))
    });
    (sights, sigma)
}

fn nearest(columns: &[Column], aside: f64) -> Option<&Column> {
    columns.iter().min_by(|a, b| (a.aside_rad - aside).abs().total_cmp(&(b.aside_rad - aside).abs()))
}
