//! Draws of a case through the solver.

use nalgebra::{DMatrix, DVector};
use protocol::marker::Marker;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use team_leader::solve::input::{Bearing, Feature, Part, Problem, Robot, Sighting};
use team_leader::solve::layout::Nuisance;
use team_leader::solve::output::Solution;
use team_leader::solve::solve;

use super::bound::{bound, of_baseline};
use super::cases::{Case, Noise, SEED, TAIL};
use super::reference::{LeastSquareError, Reference, estimate, squared_errors};
use super::scene::{CAMERA_M, Measurement, PLATE_M, RADIUS_M, Scene, What, Worn, bar_azimuth, turn};
use super::statistics::{kolmogorov_chi2, mean_bounds};
use crate::parallel;

/// Where the baseline's bound relative to the baseline is above this, the bound is only a first approximation.
pub const LINEAR_BELOW: f64 = 0.08;
/// What is to be run.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Draws a case.
    pub draws: usize,
    /// Draws of the reference where the bound is not exact; with tails (unless 0) the reference solves every draw that the solver gets.
    pub reference: usize,
    /// What errors are like.
    pub noise: Noise,
    /// Threads.
    pub threads: usize,
}

/// Ratios of the solver's root mean square errors to something.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Ratios {
    /// Distance of the first two robots.
    pub baseline: f64,
    /// Positions of all robots.
    pub positions: f64,
    /// Headings of all robots.
    pub headings: f64,
    /// Positions of all targets.
    pub targets: f64,
}

impl Ratios {
    /// The largest.
    pub fn largest(&self) -> f64 {
        self.baseline.max(self.positions).max(self.headings).max(self.targets)
    }
}

/// A χ² statistic of a case.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Consistency {
    /// Mean divided by its degrees of freedom.
    pub mean: f64,
    /// Where that must be, at 1 % over all cases together.
    pub bounds: [f64; 2],
    /// p-value of Kolmogorov's test of its distribution.
    pub p: f64,
    /// Degrees of freedom.
    pub dof: usize,
}

impl Consistency {
    fn of(values: &[f64], dof: usize, alpha: f64) -> Self {
        let mean = values.iter().sum::<f64>() / (values.len() * dof).max(1) as f64;
        Self { mean, bounds: mean_bounds(dof, values.len(), alpha), p: kolmogorov_chi2(values, dof), dof }
    }

    /// Whether the mean is within its bounds.
    pub fn holds(&self) -> bool {
        (self.bounds[0]..=self.bounds[1]).contains(&self.mean)
    }
}

/// What became of a case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// What it is.
    pub name: String,
    /// Marker.
    pub marker: &'static str,
    /// How many robots.
    pub robots: usize,
    /// Distance of two robots.
    pub baseline_m: Option<f64>,
    /// Angle at the target of two robots.
    pub parallax_deg: Option<f64>,
    /// Noise.
    pub noise_px: f64,
    /// Bound of the baseline over the baseline.
    pub relative_bound: f64,
    /// Draws without a solution.
    pub failed: usize,
    /// Draws.
    pub draws: usize,
    /// RMSE over the Cramér–Rao bound.
    pub to_bound: Ratios,
    /// Which estimator it is compared with.
    pub reference: Reference,
    /// RMSE over the reference's, where it was run.
    pub to_reference: Option<Ratios>,
    /// Mean error of the baseline, metres.
    pub baseline_bias_m: f64,
    /// Errors of the robots' poses against their joint covariance.
    pub nees_robots: Consistency,
    /// Errors of each target against its covariance.
    pub nees_target: Consistency,
    /// χ² of the solution.
    pub nis: Option<Consistency>,
}

/// Runs all cases, in their order.
pub fn run(cases: &[Case], plan: &Plan, progress: &(dyn Fn() + Sync)) -> Vec<Outcome> {
    let outcomes = parallel::map(plan.threads, cases, |case| {
        let outcome = run_case(case, plan, cases.len());
        progress();
        outcome
    });
    outcomes.into_iter().flatten().collect()
}

/// Runs a case; `None` where the measurements do not determine the layout.
pub fn run_case(case: &Case, plan: &Plan, cases: usize) -> Option<Outcome> {
    let scene = &case.scene;
    let measurements = scene.measurements();
    let sigma = case.sigma_rad();
    let bound = bound(scene, &measurements, sigma)?;
    let exact: Vec<f64> = measurements.iter().map(|m| scene.exact(m)).collect();
    let baseline_m = scene.robots[1][0].hypot(scene.robots[1][1]);
    let mut rng = ChaCha8Rng::seed_from_u64(SEED.wrapping_add(case.number << 20));
    let mut draw =
        |noise: Noise| -> Vec<f64> { exact.iter().map(|e| turn(e + sigma * noise.draw(&mut rng))).collect() };
    let mut sums = DVector::zeros(4);
    let (mut beside, mut compared) = (DVector::zeros(4), DVector::zeros(4));
    let (mut bias, mut failed) = (0.0, 0);
    let (mut robots, mut targets, mut nis) = (Vec::new(), Vec::new(), Vec::new());
    let dof = measurements.len() - bound.nrows();
    let likeliest = |measured: &[f64], starts: &[Vec<f64>]| {
        let from = |start: &Vec<f64>| estimate(scene, &measurements, measured, (sigma, plan.noise), start.clone());
        starts.iter().filter_map(from).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(x, _)| x)
    };
    let tailed = plan.noise == Noise::Tailed && plan.reference > 0;
    let relative_bound = of_baseline(scene, &bound) / baseline_m;
    // Where five times the sigma is small, too.
    let linear = TAIL.1 * relative_bound <= LINEAR_BELOW;
    let best = if tailed && linear { LeastSquareError::new(scene, &measurements, sigma) } else { None };
    for _ in 0..plan.draws {
        let measured = draw(plan.noise);
        let solution = solve(problem(scene, &measurements, &measured, sigma));
        let Some(sample) = Sample::of(scene, &solution) else {
            failed += 1;
            continue;
        };
        let squared = squared_errors(scene, &sample.estimate);
        let errors = || measured.iter().zip(&exact).map(|(m, e)| turn(m - e) / sigma).collect::<Vec<f64>>();
        let beside_it = match &best {
            Some(best) => Some(best.estimate(&errors())),
            // Of several peaks the highest need not be the one by the truth, which nobody who only has the measurements can know.
            None if tailed => likeliest(&measured, &[scene.unknowns(), sample.estimate.clone()]),
            None => None,
        };
        if let Some(x) = beside_it {
            beside += squared_errors(scene, &x);
            compared += &squared;
        }
        sums += &squared;
        let at = scene.with(&sample.estimate).robots[1];
        bias += at[0].hypot(at[1]) - baseline_m;
        robots.push(sample.nees_robots);
        targets.extend(sample.nees_targets.first());
        nis.push(solution.chi2);
    }
    let solved = (plan.draws - failed).max(1) as f64;
    let mean = sums / solved;
    let variances = bounds_of(scene, &bound);
    let to_bound = ratios(&mean, &variances);
    let curved = relative_bound > LINEAR_BELOW || to_bound.largest() > 1.05;
    let same_draws = beside.iter().all(|b| *b > 0.0).then(|| ratios(&compared, &beside));
    let alone = plan.noise == Noise::Gaussian && curved && plan.reference > 0;
    let to_reference = same_draws.or_else(|| {
        alone.then(|| {
            let mut sums = DVector::zeros(4);
            let mut count = 0.0;
            for _ in 0..plan.reference {
                if let Some(x) = likeliest(&draw(plan.noise), &[scene.unknowns()]) {
                    sums += squared_errors(scene, &x);
                    count += 1.0;
                }
            }
            ratios(&mean, &(sums / f64::max(count, 1.0)))
        })
    });
    let alpha = 0.01 / cases as f64;
    Some(Outcome {
        name: case.name(),
        marker: case.marker,
        robots: scene.robots.len(),
        baseline_m: case.baseline_m,
        parallax_deg: case.parallax_deg,
        noise_px: case.noise_px,
        relative_bound,
        failed,
        draws: plan.draws,
        to_bound,
        reference: if best.is_some() { Reference::LeastSquareError } else { Reference::LikeliestPeak },
        to_reference,
        baseline_bias_m: bias / solved,
        nees_robots: Consistency::of(&robots, 3 * (scene.robots.len() - 1), alpha),
        nees_target: Consistency::of(&targets, 2, alpha),
        nis: (dof > 0).then(|| Consistency::of(&nis, dof, alpha)),
    })
}

fn ratios(of: &DVector<f64>, to: &DVector<f64>) -> Ratios {
    let r = |k: usize| (of[k] / to[k]).sqrt();
    Ratios { baseline: r(0), positions: r(1), headings: r(2), targets: r(3) }
}

/// The bound of what [`squared_errors`] sums.
fn bounds_of(scene: &Scene, bound: &DMatrix<f64>) -> DVector<f64> {
    let robots = scene.robots.len() - 1;
    let at = |columns: Vec<usize>| columns.into_iter().map(|c| bound[(c, c)]).sum::<f64>();
    DVector::from_vec(vec![
        of_baseline(scene, bound).powi(2),
        at((0..robots).flat_map(|r| [3 * r, 3 * r + 1]).collect()),
        at((0..robots).map(|r| 3 * r + 2).collect()),
        at((3 * robots..bound.nrows()).collect()),
    ])
}

/// A solution held against the truth.
struct Sample {
    estimate: Vec<f64>,
    nees_robots: f64,
    nees_targets: Vec<f64>,
}

impl Sample {
    fn of(scene: &Scene, solution: &Solution) -> Option<Self> {
        let joint = solution.joint_covariance.as_ref()?;
        if solution.robots.len() != scene.robots.len() || solution.targets.len() != scene.targets.len() {
            return None;
        }
        let n = 3 * (scene.robots.len() - 1);
        let mut estimate = Vec::with_capacity(n + 2 * scene.targets.len());
        for robot in &solution.robots[1..] {
            estimate.extend([robot.x_m, robot.y_m, robot.heading_deg.to_radians()]);
        }
        let mut nees_targets = Vec::new();
        for (target, truth) in solution.targets.iter().zip(&scene.targets) {
            estimate.extend([target.x_m, target.y_m]);
            let c = target.covariance?;
            let cov = nalgebra::Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]);
            let e = nalgebra::Vector2::new(target.x_m - truth[0], target.y_m - truth[1]);
            nees_targets.push(e.dot(&cov.cholesky()?.solve(&e)));
        }
        let mut e = DVector::from_iterator(n, estimate.iter().zip(scene.unknowns()).map(|(a, b)| a - b).take(n));
        for k in (2..n).step_by(3) {
            e[k] = turn(e[k]);
        }
        let cov = DMatrix::from_fn(n, n, |r, c| joint.matrix[r][c]);
        let nees_robots = e.dot(&cov.cholesky()?.solve(&e));
        Some(Self { estimate, nees_robots, nees_targets })
    }
}

/// The draw as a problem like those in files.
fn problem(scene: &Scene, measurements: &[Measurement], measured: &[f64], sigma: f64) -> Problem {
    let marker = match scene.worn {
        Worn::Cylinder => Marker::Cylinder { radius_m: RADIUS_M, height_m: [0.1, 0.5], look: None },
        Worn::Bars(count) => Marker::Bars {
            radius_m: RADIUS_M,
            azimuths_deg: (0..count).map(|bar| bar_azimuth(bar, count).to_degrees()).collect(),
            height_m: [0.1, 0.5],
            code: None,
            look: None,
        },
        Worn::Plate => Marker::Rectangle {
            width_m: PLATE_M[0],
            height_m: PLATE_M[1],
            left_edge_m: 0.5 * PLATE_M[0],
            behind_m: 0.0,
            bottom_m: PLATE_M[2],
            look: None,
        },
    };
    let robot = |k: usize| Robot {
        id: format!("r{}", k + 1),
        camera_height_m: CAMERA_M,
        marker: marker.clone(),
        pose: None,
        moved: None,
        nuisance: Nuisance::default(),
    };
    let mut sightings: Vec<Sighting> = Vec::new();
    let mut bearings = Vec::new();
    for (m, &value) in measurements.iter().zip(measured) {
        if m.what == What::Target {
            let (observer, target) = (m.observer, Some(m.other));
            bearings.push(Bearing { observer, target, bearing: (value, sigma), elevation: None, time_s: None });
            continue;
        }
        if sightings.last().is_none_or(|s| (s.observer, s.peer) != (m.observer, Some(m.other))) {
            sightings.push(Sighting {
                observer: m.observer,
                peer: Some(m.other),
                bearing: None,
                range: None,
                heading: None,
                features: Vec::new(),
            });
        }
        let Some(sighting) = sightings.last_mut() else { continue };
        let part = match m.what {
            What::Tangent(side) if side > 0.0 => Part::Left,
            What::Tangent(_) => Part::Right,
            What::Bar(bar) => Part::Bar(bar),
            What::Edge(edge) => Part::Edge(edge),
            What::EdgeEnd(_, end) => {
                if let Some(ends) = sighting.features.last_mut().map(|f| f.elevation_rad.get_or_insert([0.0; 2])) {
                    ends[end] = value;
                }
                continue;
            }
            What::Target => continue,
        };
        let feature =
            Feature { part, bearing_rad: value, sigma_rad: sigma, elevation_rad: None, elevation_sigma_rad: sigma };
        sighting.features.push(feature);
    }
    let targets: Vec<String> = (0..scene.targets.len()).map(|k| format!("t{}", k + 1)).collect();
    Problem {
        robots: (0..scene.robots.len()).map(robot).collect(),
        anchor: 0,
        sightings,
        bearings,
        times: vec![None; targets.len()],
        targets,
        landmarks: Vec::new(),
        paired: Vec::new(),
        remarks: Vec::new(),
    }
}

#[cfg(test)]
mod tests;
