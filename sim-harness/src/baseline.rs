//! How well two robots know how far apart they are after they have stood for a second: whole chain, rendered pictures.
//!
//! Every layout is a room drawn anew ([`crate::peers::layout`]) of which two robots are kept that have each other in sight: the
//! observer, who wears rings, and the nearest to it of those that are at least half unhidden, 1 to 4.5 m away. Their agents see
//! pictures, their leader observations; the map that is a second younger than the first frame of which both say that they stand
//! is compared with the truth, as is the covariance that it states.

use std::sync::Arc;

use nalgebra::RowDVector;
use protocol::id::RobotId;
use protocol::message::{Motion, TeamMap};
use protocol::time::Timestamp;
use serde::Serialize;

use crate::parallel;
use crate::peers::layout::{self, Team};
use crate::peers::trial::Kind;
use crate::render::Renderer;
use crate::render::rays::Rays;
use crate::scenario::{CameraSpec, RobotsSpec, Scenario, WearOf};
use crate::score::nees::Nees;
use crate::team::{Outcome, TeamSettings, simulated};
use crate::world::World;

/// Standing, seconds.
pub const STANDING_S: f64 = 1.0;
/// Agents need some frames before they say that they stand.
const RUN_S: f64 = 2.5;
/// Of baselines.
pub const RANGE_M: [f64; 2] = [1.0, 4.5];
/// Rows of the table: range, and the RMS apart from the bias that is required, percent.
pub const ROWS: [([f64; 2], f64); 2] = [([1.0, 3.0], 1.0), ([3.5, 4.5], 2.0)];
/// Least unhidden share.
const LEAST_VISIBLE: f64 = 0.5;
/// Seeds that are tried for each layout.
const TRIES: u64 = 20;

/// What is to be drawn.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Layouts.
    pub layouts: usize,
    /// Of the first.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
    /// Of both robots.
    pub camera: CameraSpec,
}

/// A layout's outcome.
#[derive(Debug, Clone, Serialize)]
pub struct Sample {
    /// That it was drawn with.
    pub seed: u64,
    /// What the other robot wears.
    pub marker: &'static str,
    /// Truth, metres.
    pub range_m: f64,
    /// Estimate minus truth and the stated sigma, metres; none where the map did not have both robots in one frame.
    pub found: Option<[f64; 2]>,
}

/// Figures of one range.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Of the baselines.
    pub range_m: [f64; 2],
    /// How many there were, and how many the map had.
    pub layouts: [usize; 2],
    /// Mean error over the baseline.
    pub bias_percent: f64,
    /// RMS error over the baseline, bias apart.
    pub rms_percent: f64,
    /// What it should be at most.
    pub required_percent: f64,
    /// Squared error over the stated variance, and where its mean should be at 1 %.
    pub nees: Option<f64>,
    /// See `nees`.
    pub nees_bounds: Option<[f64; 2]>,
}

/// All layouts; `each` is called after every one.
///
/// # Errors
/// A team that cannot be run.
pub fn run(plan: &Plan, each: &(dyn Fn() + Sync)) -> Result<Vec<Sample>, String> {
    let rays = Arc::new(Rays::trace(&plan.camera));
    let samples = parallel::map(plan.threads, 0..plan.layouts, |n| {
        // Layouts' seeds are their own: the next one does not begin where a drawing that failed ended.
        let sample = sample(plan, &rays, plan.seed + n as u64);
        each();
        sample
    });
    samples.into_iter().filter_map(Result::transpose).collect()
}

fn sample(plan: &Plan, rays: &Arc<Rays>, seed: u64) -> Result<Option<Sample>, String> {
    let Some((scenario, marker)) = (0..TRIES).find_map(|n| pair(plan, rays, seed.wrapping_mul(TRIES).wrapping_add(n)))
    else {
        return Ok(None);
    };
    let outcome =
        simulated::run(&scenario, seed, &TeamSettings::default(), &|_| {}).map_err(|e| format!("seed {seed}: {e}"))?;
    let [a, b] = [0, 1].map(|n| outcome.world.robots()[n].first_pose);
    let range_m = (a[0] - b[0]).hypot(a[1] - b[1]);
    let found = after_standing(&outcome).and_then(|map| baseline(map, &outcome.names)).map(|[d, s]| [d - range_m, s]);
    Ok(Some(Sample { seed, marker, range_m, found }))
}

/// Two robots of a drawn room.
fn pair(plan: &Plan, rays: &Arc<Rays>, seed: u64) -> Option<(Scenario, &'static str)> {
    let (scenario, world) = layout::draw(&plan.camera, seed, RUN_S, Some(Team::Mixed))?;
    let world = Arc::new(world);
    let presence = Renderer::of_first(&world, rays).presence(0.5);
    let poses = &scenario.robots.poses;
    let range = |n: usize| (poses[n][0] - poses[0][0]).hypot(poses[n][1] - poses[0][1]);
    let fits = |n: &usize| (RANGE_M[0]..RANGE_M[1]).contains(&range(*n)) && presence[*n].visible() >= LEAST_VISIBLE;
    let other = (1..poses.len()).filter(fits).min_by(|a, b| range(*a).total_cmp(&range(*b)))?;
    let marker = scenario.robots.wear_of(&scenario.robot_ids()[other]);
    let name = Kind::of(&marker).name();
    let robots = RobotsSpec {
        count: 2,
        poses: vec![poses[0], poses[other]],
        wear: vec![WearOf { robot: RobotId::new("r2").ok()?, marker, beacon: None }],
        ..RobotsSpec::default()
    };
    let scenario = Scenario { robots, ..scenario };
    World::new(&scenario, seed).ok().map(|_| (scenario, name))
}

/// The first map a second after both robots said that they stand.
fn after_standing(outcome: &Outcome) -> Option<&TeamMap> {
    let stands = |name: &RobotId| -> Option<Timestamp> {
        let mut own = outcome.observations.iter().filter(|(robot, _)| robot == name);
        own.find(|(_, o)| o.motion == Motion::Standing).map(|(_, o)| o.capture)
    };
    // Robots' clocks are some hundredths of a second off.
    let from = outcome.names.iter().map(stands).collect::<Option<Vec<_>>>()?.into_iter().max()?;
    outcome.maps.iter().find(|map| map.stamp.seconds_since(from) >= STANDING_S)
}

/// The distance of the two robots in a map, and its sigma.
fn baseline(map: &TeamMap, names: &[RobotId]) -> Option<[f64; 2]> {
    let placed: Vec<_> = map.placed(0).collect();
    let at = |name: &RobotId| placed.iter().position(|r| r.id == *name);
    let (a, b) = (at(&names[0])?, at(&names[1])?);
    let way = placed[b].team_from_body?.position() - placed[a].team_from_body?.position();
    let length = way.norm();
    let joint = map.joint_covariance_of(0)?;
    let mut row = RowDVector::zeros(joint.ncols());
    for k in 0..2 {
        row[3 * a + k] = -way[k] / length;
        row[3 * b + k] = way[k] / length;
    }
    let variance = (&row * joint * row.transpose())[0];
    Some([length, variance.max(0.0).sqrt()])
}

/// Figures by range.
pub fn rows(samples: &[Sample]) -> Vec<Row> {
    ROWS.iter().map(|(range_m, required)| row(samples, *range_m, *required)).collect()
}

fn row(samples: &[Sample], range_m: [f64; 2], required_percent: f64) -> Row {
    let within: Vec<&Sample> = samples.iter().filter(|s| (range_m[0]..range_m[1]).contains(&s.range_m)).collect();
    let found: Vec<(f64, [f64; 2])> = within.iter().filter_map(|s| Some((s.range_m, s.found?))).collect();
    let n = found.len().max(1) as f64;
    let share = |(range, [error, _]): &(f64, [f64; 2])| 100.0 * error / range;
    let bias_percent = found.iter().map(share).sum::<f64>() / n;
    let square = found.iter().map(|f| (share(f) - bias_percent).powi(2)).sum::<f64>() / n;
    let mut nees = Nees::default();
    for (_, [error, sigma]) in &found {
        nees.add((error / sigma.max(1e-6)).powi(2), 1);
    }
    Row {
        range_m,
        layouts: [within.len(), found.len()],
        bias_percent,
        rms_percent: square.sqrt(),
        required_percent,
        nees: nees.mean(),
        nees_bounds: nees.bounds(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bias_is_apart_from_the_scatter_and_sigmas_are_held_against_errors() {
        let of = |range_m: f64, percent: f64, sigma_percent: f64| Sample {
            seed: 0,
            marker: "cylinder",
            range_m,
            found: Some([0.01 * percent * range_m, 0.01 * sigma_percent * range_m]),
        };
        let mut samples = vec![of(1.5, 1.0, 1.0), of(2.5, 3.0, 1.0), of(4.0, 0.0, 1.0)];
        samples.push(Sample { found: None, ..of(2.0, 0.0, 1.0) });
        let [near, far] = &rows(&samples)[..] else { panic!("two rows") };
        assert_eq!((near.layouts, far.layouts), ([3, 2], [1, 1]));
        assert!((near.bias_percent - 2.0).abs() < 1e-9 && (near.rms_percent - 1.0).abs() < 1e-9);
        assert!((near.nees.unwrap() - 5.0).abs() < 1e-9);
    }

    #[test]
    fn two_robots_know_their_distance_after_a_second() {
        let camera = CameraSpec::default();
        let plan = Plan { layouts: 1, seed: 3, threads: 1, camera };
        let samples = run(&plan, &|| {}).unwrap();
        let [sample] = &samples[..] else { panic!("{samples:?}") };
        let [error, sigma] = sample.found.unwrap();
        assert!(error.abs() < 0.03 * sample.range_m && error.abs() < 4.0 * sigma, "{sample:?}");
    }
}
