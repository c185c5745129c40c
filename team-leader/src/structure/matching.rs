//! Which upright edges of which views are one.
//!
//! Problem: of n edges in each of two views up to n² pairs of rays cross, n of which are real.
//!
//! Insight: a real crossing looks the same from both sides (the grey levels beside the edge, the heights of its ends), and other
//! views have an edge where it should be. Each crossing is weighed against its edges having nothing to do with each other, in
//! nats, as tracks are in [`crate::correspondence`]:
//!
//! ```text
//!  Σ ln t( θᵢ − θᵢ(x̂) ; σᵢ ) − Σ ln(edges of view i per rad, there) + ln( 2π √|P| · landmarks per m² ) + levels + heights
//! ```
//! The heaviest is taken first, with its edges; those that wanted one of them too are weighed again without it. Where two that
//! want the same edge weigh about the same nobody knows which is right (books, railings), and neither is taken.

use std::collections::BinaryHeap;
use std::f64::consts::TAU;

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2};
use protocol::angle::{difference, wrap};
use protocol::frames::Pose2;
use protocol::message::UprightEdge;

use super::Landmark;
use crate::calibration::kernel;
use crate::stereo::tails::log_student;

/// Rays that meet at a flatter angle (sine) say nothing about range.
const LEAST_PARALLAX: f64 = 0.12;
/// Where edges may be, metres from each place.
const RANGE_M: [f64; 2] = [0.4, 12.0];
/// Upright edges that two robots can see, in a square metre of a furnished room.
const DENSITY_M2: f64 = 0.4;
/// Corners are rounded, posts have another tangent from each side: metres.
const ROUND_M: f64 = 0.01;
/// A further view's edge is looked for within so many squared sigmas.
const GATE: f64 = 12.0;
/// Scale of the difference of the logarithms of the levels on one side of an edge, of one surface and of any two; the part of
/// sides on which both views see the same surface (what is behind a post is another wall from each side).
const LEVEL: [f64; 2] = [0.15, 0.7];
const SAME_SURFACE: f64 = 0.7;
/// The same of the heights of ends, metres; the height of an end is known to this, and to so much of an angle.
const END_M: [f64; 2] = [0.06, 0.6];
const END_RAD: f64 = 0.008;
const SAME_END: f64 = 0.6;
/// Pairs that look less alike than this are not weighed at all, nats.
const LEAST_ALIKE: f64 = -0.5;
/// What must speak for a landmark, nats: of two views and of more.
const ENOUGH: [f64; 2] = [7.0, 6.0];
/// What wants one of its edges too and is elsewhere (metres) speaks less by so much, nats: books and railings look alike.
const LEAD: f64 = 4.0;
const ELSEWHERE_M: f64 = 0.03;
/// How densely edges stand is counted this far to either side, radians.
const BESIDE_RAD: f64 = 0.1;
/// Steps of Gauss and Newton.
const STEPS: usize = 2;
/// Most candidates.
const MAX_CANDIDATES: usize = 20_000;

/// An upright edge as a robot saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// In the body frame, rad.
    pub bearing_rad: f64,
    /// Its standard deviation.
    pub sigma_rad: f64,
    /// Logarithms of the grey levels left and right of it.
    pub log_levels: [f64; 2],
    /// Tangents of the elevations of its lower and upper end.
    pub tangents: [f64; 2],
    /// Whether these are its ends; else it goes on.
    pub ends: [bool; 2],
}

impl Edge {
    /// As it came.
    pub fn of(edge: &UprightEdge) -> Self {
        /// Below the noise of any sensor levels say nothing more.
        const DARK: f64 = 8.0;
        Self {
            bearing_rad: edge.bearing.rad(),
            sigma_rad: edge.sigma.value().max(1e-4),
            log_levels: edge.levels.map(|l| (f64::from(l) + DARK).ln()),
            tangents: edge.elevation.map(|e| e.rad().clamp(-1.4, 1.4).tan()),
            ends: edge.ends,
        }
    }
}

/// A view, and where it is from.
#[derive(Debug, Clone, Copy)]
pub struct Posed<'a> {
    /// Whose.
    pub robot: usize,
    /// From where.
    pub pose: Pose2,
    /// Of the pose by itself.
    pub covariance: Matrix3<f64>,
    /// Of the camera, metres.
    pub height_m: f64,
    /// What was seen.
    pub edges: &'a [Edge],
}

impl Posed<'_> {
    /// Variance of an edge's bearing at a distance; with the pose's part, for judging.
    fn var(&self, edge: &Edge, range_m: f64, with_pose: bool) -> f64 {
        let own = edge.sigma_rad.powi(2) + (ROUND_M / range_m).powi(2);
        if !with_pose {
            return own;
        }
        let c = &self.covariance;
        own + c[(2, 2)] + 0.5 * (c[(0, 0)] + c[(1, 1)]) / (range_m * range_m)
    }

    fn pose(&self) -> [f64; 3] {
        [self.pose.x_m, self.pose.y_m, self.pose.heading_rad]
    }
}

/// Edges of several views (view, edge) that may be one.
#[derive(Debug, Clone)]
struct Candidate {
    log_ratio: f64,
    members: Vec<(usize, usize)>,
    position: Vector2<f64>,
}

impl Candidate {
    /// Whether it is elsewhere than one that wants one of its edges, and nearly as good.
    fn disputes(&self, other: &Self) -> bool {
        self.log_ratio > other.log_ratio - LEAD && (self.position - other.position).norm() > ELSEWHERE_M
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.log_ratio.total_cmp(&other.log_ratio).then_with(|| other.members.cmp(&self.members))
    }
}

/// The landmarks that some views have in common. `joint`: the covariance of the poses of two of them.
pub fn landmarks(views: &[Posed<'_>], joint: &dyn Fn(usize, usize) -> Matrix3<f64>) -> Vec<Landmark> {
    let matching = Matching::new(views);
    let mut used: Vec<Vec<bool>> = views.iter().map(|v| vec![false; v.edges.len()]).collect();
    let mut heap = BinaryHeap::new();
    for a in 0..views.len() {
        for b in a + 1..views.len() {
            matching.pairs(a, b, &used, &mut heap);
        }
    }
    let rivals = Rivals::new(views, &heap);
    let mut found = Vec::new();
    while let Some(best) = heap.pop() {
        let [first, second] = [best.members[0], best.members[1]];
        if [first, second].iter().any(|(v, e)| used[*v][*e]) {
            continue;
        }
        if best.members.iter().any(|(v, e)| used[*v][*e]) {
            heap.extend(matching.weigh(first, second, best.position, &used));
            continue;
        }
        let is_free = |c: &Candidate| c.members.iter().all(|(v, e)| !used[*v][*e]);
        if rivals.of(&best).any(|rival| rival.disputes(&best) && is_free(rival)) {
            continue;
        }
        best.members.iter().for_each(|(v, e)| used[*v][*e] = true);
        found.extend(matching.landmark(&best, joint));
    }
    found
}

/// All first candidates, by the edges that they want.
struct Rivals {
    all: Vec<Candidate>,
    /// By view and edge: places in `all`.
    wanting: Vec<Vec<Vec<usize>>>,
}

impl Rivals {
    fn new(views: &[Posed<'_>], heap: &BinaryHeap<Candidate>) -> Self {
        let all: Vec<Candidate> = heap.iter().cloned().collect();
        let mut wanting: Vec<Vec<Vec<usize>>> = views.iter().map(|v| vec![Vec::new(); v.edges.len()]).collect();
        for (n, candidate) in all.iter().enumerate() {
            candidate.members.iter().for_each(|(v, e)| wanting[*v][*e].push(n));
        }
        Self { all, wanting }
    }

    /// Those that want an edge of this one.
    fn of<'a>(&'a self, candidate: &'a Candidate) -> impl Iterator<Item = &'a Candidate> {
        candidate.members.iter().flat_map(|(v, e)| &self.wanting[*v][*e]).map(|n| &self.all[*n])
    }
}

struct Matching<'a> {
    views: &'a [Posed<'a>],
    /// Edges of each view by bearing.
    sorted: Vec<Vec<(f64, usize)>>,
    /// Logarithm of how many a radian there are about each edge.
    log_densities: Vec<Vec<f64>>,
}

impl<'a> Matching<'a> {
    fn new(views: &'a [Posed<'a>]) -> Self {
        let sorted = views.iter().map(|v| {
            let mut edges: Vec<_> = v.edges.iter().enumerate().map(|(k, e)| (e.bearing_rad, k)).collect();
            edges.sort_by(|x, y| x.0.total_cmp(&y.0));
            edges
        });
        Self { views, sorted: sorted.collect(), log_densities: views.iter().map(|v| log_densities(v.edges)).collect() }
    }

    fn edge(&self, (view, edge): (usize, usize)) -> &Edge {
        &self.views[view].edges[edge]
    }

    /// All pairs of edges of two views that may be one.
    fn pairs(&self, a: usize, b: usize, used: &[Vec<bool>], heap: &mut BinaryHeap<Candidate>) {
        let (pose_a, pose_b) = (&self.views[a].pose, &self.views[b].pose);
        let baseline_m = (pose_a.position() - pose_b.position()).norm();
        if baseline_m < RANGE_M[0] {
            return;
        }
        // Angles at both ends of the baseline, as in (5-1): few of the many pairs meet at all, and these alone are looked at.
        let (bearing_21, bearing_12) = (pose_a.bearing_to(pose_b.position()), pose_b.bearing_to(pose_a.position()));
        let s1: Vec<_> = self.views[a].edges.iter().map(|e| wrap(e.bearing_rad - bearing_21).sin_cos()).collect();
        let s2: Vec<_> = self.views[b].edges.iter().map(|e| wrap(bearing_12 - e.bearing_rad).sin_cos()).collect();
        for (k, (sin_1, cos_1)) in s1.iter().enumerate() {
            for (l, (sin_2, cos_2)) in s2.iter().enumerate() {
                // Both rays to the same side, and they meet: the sine of their sum has that side's sign.
                let side = sin_1.signum();
                let sine = side * (sin_1 * cos_2 + cos_1 * sin_2);
                if sin_1 * sin_2 <= 0.0 || sine < LEAST_PARALLAX {
                    continue;
                }
                let ranges = [sin_2, sin_1].map(|s| baseline_m * s.abs() / sine);
                let inside = ranges.iter().all(|r| (RANGE_M[0]..RANGE_M[1]).contains(r));
                if inside
                    && heap.len() < MAX_CANDIDATES
                    && alike_levels(self.edge((a, k)), self.edge((b, l))) >= LEAST_ALIKE
                {
                    let (sin, cos) = self.edge((a, k)).bearing_rad.sin_cos();
                    let met = pose_a.transform(ranges[0] * Vector2::new(cos, sin));
                    heap.extend(self.weigh((a, k), (b, l), met, used));
                }
            }
        }
    }

    /// What speaks for two edges being one near `position`, with all of other views that are not used and pass there.
    fn weigh(
        &self,
        a: (usize, usize),
        b: (usize, usize),
        position: Vector2<f64>,
        used: &[Vec<bool>],
    ) -> Option<Candidate> {
        let alike = self.alike(a, b, position);
        if alike < LEAST_ALIKE {
            return None;
        }
        let mut members = vec![a, b];
        let (_, covariance) = self.fit(&members, position)?;
        for view in (0..self.views.len()).filter(|v| *v != a.0 && *v != b.0) {
            members.extend(self.further(view, a, position, &covariance, used));
        }
        let (position, covariance) = self.fit(&members, position)?;
        let mut log_ratio = (TAU * covariance.determinant().max(0.0).sqrt() * DENSITY_M2).ln();
        for &(v, e) in &members {
            let (view, edge) = (&self.views[v], self.edge((v, e)));
            let (bearing, ..) = kernel::bearing(view.pose(), position.into());
            let range_m = (position - view.pose.position()).norm();
            if !(RANGE_M[0]..RANGE_M[1]).contains(&range_m) {
                return None;
            }
            let var = view.var(edge, range_m, true);
            let d2 = wrap(edge.bearing_rad - bearing).powi(2) / var;
            log_ratio += log_student(d2, var) - self.log_densities[v][e];
        }
        let pairs = members.iter().enumerate().flat_map(|(n, x)| members[n + 1..].iter().map(move |y| (*x, *y)));
        let likeness: Vec<f64> = pairs.map(|(x, y)| self.alike(x, y, position)).collect();
        log_ratio += likeness.iter().sum::<f64>() / likeness.len() as f64 * (members.len() - 1) as f64;
        let enough = if members.len() == 2 { ENOUGH[0] } else { ENOUGH[1] };
        (log_ratio > enough).then_some(Candidate { log_ratio, members, position })
    }

    /// The edge of a further view that speaks most for one at `position`, if any does.
    fn further(
        &self,
        view: usize,
        a: (usize, usize),
        position: Vector2<f64>,
        covariance: &Matrix2<f64>,
        used: &[Vec<bool>],
    ) -> Option<(usize, usize)> {
        let posed = &self.views[view];
        let away = position - posed.pose.position();
        let range_m = away.norm();
        if !(RANGE_M[0]..RANGE_M[1]).contains(&range_m) {
            return None;
        }
        let across = Vector2::new(-away.y, away.x) / range_m;
        let spread_var = across.dot(&(covariance * across)) / (range_m * range_m);
        let bearing = posed.pose.bearing_to(position);
        let sorted = &self.sorted[view];
        let reach = (GATE * (posed.var(&WORST, range_m, true) + spread_var)).sqrt().min(0.2);
        let first = sorted.partition_point(|(b, _)| *b < bearing - reach);
        // Over the seam: all that is behind it, or before it.
        let near =
            sorted[first..].iter().chain(&sorted[..first]).take_while(|(b, _)| difference(*b, bearing).abs() < reach);
        near.filter(|(_, e)| !used[view][*e])
            .filter_map(|(b, e)| {
                let var = posed.var(self.edge((view, *e)), range_m, true) + spread_var;
                let d2 = difference(*b, bearing).powi(2) / var;
                let nats = log_student(d2, var) - self.log_densities[view][*e] + self.alike(a, (view, *e), position);
                (d2 < GATE && nats > 0.0).then_some((nats, (view, *e)))
            })
            .max_by(|x, y| x.0.total_cmp(&y.0))
            .map(|(_, member)| member)
    }

    /// How much two edges look like one at `position`, nats.
    fn alike(&self, a: (usize, usize), b: (usize, usize), position: Vector2<f64>) -> f64 {
        let mut nats = alike_levels(self.edge(a), self.edge(b));
        for end in 0..2 {
            let [(za, sa), (zb, sb)] = [a, b].map(|(v, e)| {
                let (view, edge) = (&self.views[v], self.edge((v, e)));
                let range_m = (position - view.pose.position()).norm();
                (view.height_m + range_m * edge.tangents[end], range_m * END_RAD)
            });
            if self.edge(a).ends[end] && self.edge(b).ends[end] {
                let sigma = END_M[0].hypot(sa).hypot(sb);
                nats += alike(za - zb, [sigma, END_M[1].max(sigma)], SAME_END);
            }
        }
        nats
    }

    /// The best place for some edges, and its covariance given exact poses.
    fn fit(&self, members: &[(usize, usize)], start: Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let mut position = start;
        let mut covariance = Matrix2::zeros();
        for step in 0..=STEPS {
            let (mut information, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
            for &(v, e) in members {
                let (view, edge) = (&self.views[v], self.edge((v, e)));
                let (bearing, _, to_point) = kernel::bearing(view.pose(), position.into());
                let row = Vector2::from(to_point);
                let var = view.var(edge, (position - view.pose.position()).norm().max(RANGE_M[0]), false);
                information += row * row.transpose() / var;
                gradient += row * wrap(edge.bearing_rad - bearing) / var;
            }
            covariance = information.try_inverse()?;
            if step < STEPS {
                position += covariance * gradient;
            }
        }
        Some((position, covariance))
    }

    fn landmark(&self, found: &Candidate, joint: &dyn Fn(usize, usize) -> Matrix3<f64>) -> Option<Landmark> {
        let (position, own) = self.fit(&found.members, found.position)?;
        let dependence: Vec<(usize, Matrix2x3<f64>)> = found
            .members
            .iter()
            .map(|&(v, e)| {
                let (view, edge) = (&self.views[v], self.edge((v, e)));
                let (_, to_pose, to_point) = kernel::bearing(view.pose(), position.into());
                let var = view.var(edge, (position - view.pose.position()).norm(), false);
                (v, -own * Vector2::from(to_point) * nalgebra::RowVector3::from(to_pose) / var)
            })
            .collect();
        let mut covariance = own;
        for (a, da) in &dependence {
            for (b, db) in &dependence {
                covariance += da * joint(*a, *b) * db.transpose();
            }
        }
        let heights = |end: usize| {
            found.members.iter().map(move |&(v, e)| {
                let view = &self.views[v];
                view.height_m + (position - view.pose.position()).norm() * self.edge((v, e)).tangents[end]
            })
        };
        let mut robots: Vec<usize> = found.members.iter().map(|(v, _)| self.views[*v].robot).collect();
        robots.sort_unstable();
        robots.dedup();
        Some(Landmark {
            position,
            covariance: 0.5 * (covariance + covariance.transpose()),
            extent_m: [heights(0).fold(f64::INFINITY, f64::min).max(0.0), heights(1).fold(0.0, f64::max)],
            robots,
            views: found.members.len(),
        })
    }
}

/// An edge whose bearing is as unsure as any that is used.
const WORST: Edge =
    Edge { bearing_rad: 0.0, sigma_rad: 5e-3, log_levels: [0.0; 2], tangents: [0.0; 2], ends: [false; 2] };

/// How many edges a radian a view has about each of its edges: more in a bookcase than on a wall.
fn log_densities(edges: &[Edge]) -> Vec<f64> {
    let everywhere = edges.len() as f64 / TAU;
    let near =
        |edge: &Edge| edges.iter().filter(|e| difference(e.bearing_rad, edge.bearing_rad).abs() < BESIDE_RAD).count();
    edges.iter().map(|edge| (near(edge) as f64 / (2.0 * BESIDE_RAD)).max(everywhere).ln()).collect()
}

/// How much the surfaces beside two edges look the same, nats.
fn alike_levels(a: &Edge, b: &Edge) -> f64 {
    (0..2).map(|side| alike(a.log_levels[side] - b.log_levels[side], LEVEL, SAME_SURFACE)).sum()
}

/// ln of the density of a difference `x`, of which a part is of scale `same` and the others of scale `any`, over that of `any`
/// (Student's t with four degrees of freedom).
fn alike(x: f64, [same, any]: [f64; 2], part: f64) -> f64 {
    let width = |s: f64| 1.0 + 0.25 * (x / s).powi(2);
    let ratio = width(any) / width(same);
    (part * any / same * ratio * ratio * ratio.sqrt() + 1.0 - part).ln()
}

#[cfg(test)]
mod tests;
