//! What the measurements determine, what least, and what would cure the rest.
//!
//! A direction of the unknowns that changes no measurement is a null vector of the information. With the targets eliminated
//! (`joint`), it is a null vector of the robots' reduced information, carried on to the targets, or one of a single target's
//! own part (two rays along one line, say). A further measurement cures it if its derivative along it is not zero.

use nalgebra::{DMatrix, SMatrix};

use super::input::Problem;
use super::joint::Normal;
use super::layout::{Layout, State, TARGET};
use super::terms::{Kind, Other, Term};

/// An eigenvalue of the scaled information below this part of one is zero.
const RANK_TOLERANCE: f64 = 1e-13;
/// The same where targets were eliminated first, which costs digits.
const REDUCED_TOLERANCE: f64 = 1e-10;
/// With more unknowns the weakest direction is looked for among the robots and in each target apart.
const DENSE: usize = 80;
/// Sigmas by which a cured direction is measured at least (per metre or radian of it).
const CURED: f64 = 1e-3;

/// What is determined worst.
#[derive(Debug, Clone, PartialEq)]
pub struct Weakest {
    /// Directions that no measurement determines.
    pub undetermined: Vec<Vec<f64>>,
    /// The weakest direction (unit length; metres, radians, seconds), undetermined ones first.
    pub direction: Vec<f64>,
    /// Its standard deviation; infinite where it is not determined.
    pub sigma: f64,
}

/// From the normal equations and the targets' covariances.
pub fn weakest(normal: &Normal, layout: &Layout, targets: &[SMatrix<f64, TARGET, TARGET>]) -> Weakest {
    if layout.unknowns == 0 {
        return Weakest { undetermined: Vec::new(), direction: Vec::new(), sigma: 0.0 };
    }
    let all = (layout.unknowns <= DENSE).then(|| dense(normal, layout));
    let undetermined = all.as_ref().map_or_else(|| undetermined(normal, layout), |all| undetermined_dense(all, layout));
    if let Some(direction) = undetermined.first() {
        let direction = direction.clone();
        return Weakest { undetermined, direction, sigma: f64::INFINITY };
    }
    let (direction, sigma) = all.map_or_else(|| least_sparse(normal, layout, targets), least_dense);
    Weakest { undetermined, direction, sigma }
}

/// Null vectors of the whole information, unit length.
fn undetermined_dense(all: &DMatrix<f64>, layout: &Layout) -> Vec<Vec<f64>> {
    let n = all.nrows();
    let mut scale: Vec<f64> = (0..n).map(|k| if all[(k, k)] > 0.0 { all[(k, k)].sqrt() } else { 1.0 }).collect();
    for columns in layout.robots.iter().chain(&layout.targets) {
        alike(columns, &mut scale);
    }
    let eigen = DMatrix::from_fn(n, n, |r, c| all[(r, c)] / (scale[r] * scale[c])).symmetric_eigen();
    let null = eigen.eigenvalues.iter().enumerate().filter(|(_, v)| **v < RANK_TOLERANCE);
    null.map(|(k, _)| unit_length((0..n).map(|r| eigen.eigenvectors[(r, k)] / scale[r]).collect())).collect()
}

/// Null vectors, unit length.
fn undetermined(normal: &Normal, layout: &Layout) -> Vec<Vec<f64>> {
    let mut found = Vec::new();
    let n = layout.robot_unknowns;
    if n > 0 {
        let reduced = normal.reduced();
        let mut scale: Vec<f64> = (0..n).map(|k| normal.robots[(k, k)].max(f64::MIN_POSITIVE).sqrt()).collect();
        for columns in &layout.robots {
            alike(columns, &mut scale);
        }
        let unit = DMatrix::from_fn(n, n, |r, c| {
            let value = reduced[(r, c)] / (scale[r] * scale[c]);
            if normal.robots[(r, r)] == 0.0 || normal.robots[(c, c)] == 0.0 { 0.0 } else { value }
        });
        let eigen = unit.symmetric_eigen();
        for (k, _) in eigen.eigenvalues.iter().enumerate().filter(|(_, v)| **v < REDUCED_TOLERANCE) {
            let robots: Vec<f64> = (0..n)
                .map(|r| eigen.eigenvectors[(r, k)] / if normal.robots[(r, r)] > 0.0 { scale[r] } else { 1.0 })
                .collect();
            found.push(carried(normal, layout, &robots));
        }
    }
    for (target, columns) in normal.targets.iter().zip(&layout.targets) {
        let mut scale: [f64; TARGET] = std::array::from_fn(|k| target.own[(k, k)].max(f64::MIN_POSITIVE).sqrt());
        if columns[0].is_some() {
            alike(&[Some(0), Some(1), None, None, None], &mut scale);
        }
        let unit = SMatrix::<f64, TARGET, TARGET>::from_fn(|r, c| {
            if target.own[(r, r)] > 0.0 && target.own[(c, c)] > 0.0 {
                target.own[(r, c)] / (scale[r] * scale[c])
            } else {
                0.0
            }
        });
        let eigen = unit.symmetric_eigen();
        for (k, _) in eigen.eigenvalues.iter().enumerate().filter(|(_, v)| **v < RANK_TOLERANCE) {
            let mut direction = vec![0.0; layout.unknowns];
            for (r, column) in columns.iter().enumerate() {
                if let Some(column) = *column {
                    let scale = if target.own[(r, r)] > 0.0 { scale[r] } else { 1.0 };
                    direction[column] = eigen.eigenvectors[(r, k)] / scale;
                }
            }
            found.push(unit_length(direction));
        }
    }
    found
}

/// A direction of the robots with what the targets do along it.
fn carried(normal: &Normal, layout: &Layout, robots: &[f64]) -> Vec<f64> {
    let mut direction = vec![0.0; layout.unknowns];
    direction[..robots.len()].copy_from_slice(robots);
    for (target, columns) in normal.targets.iter().zip(&layout.targets) {
        let pull = target.columns.iter().enumerate().map(|(k, &c)| target.cross.column(k) * robots[c]);
        let mut sum = nalgebra::SVector::<f64, TARGET>::zeros();
        for column in pull {
            sum += column;
        }
        let own = -(target.inverse() * sum);
        for (k, column) in columns.iter().enumerate() {
            if let Some(column) = *column {
                direction[column] = own[k];
            }
        }
    }
    unit_length(direction)
}

/// x and y are of one unit: scaled alike, a direction in which nothing is measured stays small.
fn alike(columns: &[Option<usize>; 5], scale: &mut [f64]) {
    if let [Some(x), Some(y), ..] = *columns {
        let larger = scale[x].max(scale[y]);
        (scale[x], scale[y]) = (larger, larger);
    }
}

fn unit_length(mut direction: Vec<f64>) -> Vec<f64> {
    let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
    if length > 0.0 {
        for d in &mut direction {
            *d /= length;
        }
    }
    direction
}

/// The whole information.
pub fn dense(normal: &Normal, layout: &Layout) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(layout.unknowns, layout.unknowns);
    let n = layout.robot_unknowns;
    all.view_mut((0, 0), (n, n)).copy_from(&normal.robots);
    for (target, columns) in normal.targets.iter().zip(&layout.targets) {
        for (r, row) in columns.iter().enumerate() {
            let Some(row) = *row else { continue };
            for (c, column) in columns.iter().enumerate() {
                if let Some(column) = *column {
                    all[(row, column)] = target.own[(r, c)];
                }
            }
            for (k, &column) in target.columns.iter().enumerate() {
                all[(row, column)] = target.cross[(r, k)];
                all[(column, row)] = target.cross[(r, k)];
            }
        }
    }
    all
}

fn least_dense(all: DMatrix<f64>) -> (Vec<f64>, f64) {
    let eigen = all.symmetric_eigen();
    let k = eigen.eigenvalues.imin();
    (eigen.eigenvectors.column(k).iter().copied().collect(), eigen.eigenvalues[k].max(f64::MIN_POSITIVE).sqrt().recip())
}

fn least_sparse(normal: &Normal, layout: &Layout, targets: &[SMatrix<f64, TARGET, TARGET>]) -> (Vec<f64>, f64) {
    let mut best = (vec![0.0; layout.unknowns], 0.0);
    if layout.robot_unknowns > 0 {
        let eigen = normal.reduced().symmetric_eigen();
        let k = eigen.eigenvalues.imin();
        let robots: Vec<f64> = eigen.eigenvectors.column(k).iter().copied().collect();
        let direction = carried(normal, layout, &robots);
        // Along the direction in which robots and targets go together.
        let share = direction[..layout.robot_unknowns].iter().map(|d| d * d).sum::<f64>().sqrt().max(1e-9);
        best = (direction, eigen.eigenvalues[k].max(f64::MIN_POSITIVE).sqrt().recip() / share);
    }
    for (covariance, columns) in targets.iter().zip(&layout.targets) {
        let eigen = covariance.symmetric_eigen();
        let k = eigen.eigenvalues.imax();
        let sigma = eigen.eigenvalues[k].max(0.0).sqrt();
        if sigma > best.1 {
            let mut direction = vec![0.0; layout.unknowns];
            for (r, column) in columns.iter().enumerate() {
                if let Some(column) = *column {
                    direction[column] = eigen.eigenvectors[(r, k)];
                }
            }
            best = (direction, sigma);
        }
    }
    best
}

/// Measurements that would determine what is not determined, in words, fewest first; empty where none was found.
pub fn cures(weakest: &Weakest, layout: &Layout, state: &State, problem: &Problem, placed: &[bool]) -> Vec<String> {
    let mut open: Vec<Vec<f64>> = weakest.undetermined.clone();
    let mut words = Vec::new();
    let candidates = candidates(problem, placed);
    while !open.is_empty() && words.len() < 8 {
        let best = candidates
            .iter()
            .map(|(term, text)| (open.iter().map(|d| along(term, layout, state, d).powi(2)).sum::<f64>(), term, text))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((size, term, text)) = best.filter(|(size, ..)| size.sqrt() > CURED) else { break };
        words.push(text.clone());
        // What remains open is what that measurement does not see.
        let slopes: Vec<f64> = open.iter().map(|d| along(term, layout, state, d)).collect();
        let Some(pivot) = (0..open.len()).max_by(|a, b| slopes[*a].abs().total_cmp(&slopes[*b].abs())) else { break };
        let (lead, slope) = (open.remove(pivot), slopes[pivot]);
        for (direction, s) in
            open.iter_mut().zip(slopes.iter().enumerate().filter(|(k, _)| *k != pivot).map(|(_, s)| s))
        {
            for (d, l) in direction.iter_mut().zip(&lead) {
                *d -= s / slope * l;
            }
        }
        open.retain(|d| d.iter().any(|x| x.abs() > 1e-9));
        if size <= 0.0 {
            break;
        }
    }
    words
}

/// How much the measurement changes along a direction.
fn along(term: &Term, layout: &Layout, state: &State, direction: &[f64]) -> f64 {
    let row = term.row(state);
    let part = |columns: &[Option<usize>; 5], d: &[f64; 5]| -> f64 {
        columns.iter().zip(d).filter_map(|(c, d)| Some(direction[(*c)?] * d)).sum()
    };
    let other = match term.other {
        Other::Robot(r) => part(&layout.robots[r], &row.other),
        Other::Target(t) => part(&layout.targets[t], &row.other),
    };
    part(&layout.robots[term.observer], &row.observer) + other
}

/// Sightings and distances that were not made.
fn candidates(problem: &Problem, placed: &[bool]) -> Vec<(Term, String)> {
    let robots: Vec<usize> = (0..placed.len()).filter(|r| placed[*r]).collect();
    let mut found = Vec::new();
    let term = |observer, other, kind| Term { observer, other, kind, measured: 0.0, sigma: 1.0, since_s: 0.0 };
    for &i in &robots {
        for &j in robots.iter().filter(|j| **j != i) {
            let (a, b) = (&problem.robots[i].id, &problem.robots[j].id);
            if !problem.sightings.iter().any(|s| s.observer == i && s.peer == Some(j)) {
                found.push((term(i, Other::Robot(j), Kind::Bearing), format!("a sighting of {b} by {a}")));
            }
            if i < j {
                found.push((term(i, Other::Robot(j), Kind::Range), format!("a distance between {a} and {b}")));
            }
        }
        for (t, id) in problem.targets.iter().enumerate() {
            if !problem.bearings.iter().any(|b| b.observer == i && b.target == Some(t)) {
                let text = format!("a bearing of {id} by {}", problem.robots[i].id);
                found.push((term(i, Other::Target(t), Kind::Bearing), text));
            }
        }
    }
    found
}
