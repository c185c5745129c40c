//! Several seeds: the mean and the worst of each figure, NEES pooled.

use serde::Serialize;

use super::nees::Nees;
use super::scores::{Driving, Latency, RobotScores, Scores, TargetScores};
use super::statistics::mean;
use super::structure::StructureScores;

/// Several runs of one scenario.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Which seeds.
    pub seeds: Vec<u64>,
    /// Of each run.
    pub duration_s: f64,
    /// Mean of each figure; NEES over all samples with the bounds for so many; switches and false tracks of all runs together
    /// are under `total`.
    pub mean: Figures,
    /// Worst of each figure; of NEES the one farthest from 1 by its ratio, with its own bounds.
    pub worst: Figures,
    /// Sums over the runs.
    pub total: Total,
    /// What stands still, over the runs.
    pub structure: StructureScores,
    /// Each run.
    pub runs: Vec<Scores>,
}

/// The figures of [`Scores`].
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// Poses.
    pub robots: RobotScores,
    /// People; counts are in `id_switches` and `false_tracks` here as means.
    pub targets: TargetScores,
    /// From the arrival of an observation to its map.
    pub latency_ms: Latency,
}

/// Sums over the runs.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Total {
    /// As in CLEAR-MOT.
    pub id_switches: usize,
    /// Targets that mostly follow nobody.
    pub false_tracks: usize,
}

impl Summary {
    /// Of at least one run; `None` of none.
    pub fn new(runs: Vec<Scores>) -> Option<Self> {
        let first = runs.first()?;
        let total = Total {
            id_switches: runs.iter().map(|r| r.targets.id_switches).sum(),
            false_tracks: runs.iter().map(|r| r.targets.false_tracks).sum(),
        };
        Some(Self {
            scenario: first.scenario.clone(),
            seeds: runs.iter().map(|r| r.seed).collect(),
            duration_s: first.duration_s,
            mean: mean_of(&runs, total),
            worst: worst_of(&runs),
            total,
            structure: StructureScores::pooled(runs.iter().map(|r| &r.structure)),
            runs,
        })
    }
}

fn mean_of(runs: &[Scores], total: Total) -> Figures {
    let of = |figure: &dyn Fn(&Scores) -> Option<f64>| mean(&runs.iter().filter_map(figure).collect::<Vec<_>>());
    let pool = |figure: &dyn Fn(&Scores) -> Nees| {
        let mut all = Nees::default();
        runs.iter().for_each(|run| all += figure(run));
        all
    };
    let each = |count: usize| (count as f64 / runs.len() as f64).round() as usize;
    fold(
        of,
        pool(&|r| r.robots.nees_sum),
        pool(&|r| r.targets.nees_sum),
        of,
        [total.id_switches, total.false_tracks].map(each),
    )
}

fn worst_of(runs: &[Scores]) -> Figures {
    let largest = |figure: &dyn Fn(&Scores) -> Option<f64>| runs.iter().filter_map(figure).max_by(f64::total_cmp);
    let smallest = |figure: &dyn Fn(&Scores) -> Option<f64>| runs.iter().filter_map(figure).min_by(f64::total_cmp);
    let farthest = |figure: &dyn Fn(&Scores) -> Nees| {
        let off = |nees: &Nees| nees.mean().map_or(0.0, |mean| mean.max(1e-12).ln().abs());
        runs.iter().map(figure).max_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default()
    };
    let most = |figure: &dyn Fn(&Scores) -> usize| runs.iter().map(figure).max().unwrap_or_default();
    fold(
        largest,
        farthest(&|r| r.robots.nees_sum),
        farthest(&|r| r.targets.nees_sum),
        smallest,
        [most(&|r| r.targets.id_switches), most(&|r| r.targets.false_tracks)],
    )
}

/// Each figure by one rule: `error` for what should be small, `share` for what should be near 1.
fn fold(
    error: impl Fn(&dyn Fn(&Scores) -> Option<f64>) -> Option<f64>,
    robots: Nees,
    targets: Nees,
    share: impl Fn(&dyn Fn(&Scores) -> Option<f64>) -> Option<f64>,
    [id_switches, false_tracks]: [usize; 2],
) -> Figures {
    Figures {
        robots: RobotScores {
            position_rms_m: error(&|r| r.robots.position_rms_m),
            heading_rms_deg: error(&|r| r.robots.heading_rms_deg),
            nees: robots.mean(),
            nees_bounds: robots.bounds(),
            driving: Driving {
                position_rms_m: error(&|r| r.robots.driving.position_rms_m),
                heading_rms_deg: error(&|r| r.robots.driving.heading_rms_deg),
                moving_position_rms_m: error(&|r| r.robots.driving.moving_position_rms_m),
                moving_heading_rms_deg: error(&|r| r.robots.driving.moving_heading_rms_deg),
            },
            placed: share(&|r| r.robots.placed),
            nees_sum: robots,
        },
        targets: TargetScores {
            rms_m: error(&|r| r.targets.rms_m),
            coverage: share(&|r| r.targets.coverage),
            gospa_m: error(&|r| r.targets.gospa_m),
            id_switches,
            false_tracks,
            nees: targets.mean(),
            nees_bounds: targets.bounds(),
            rms_within_5m_m: error(&|r| r.targets.rms_within_5m_m),
            nees_sum: targets,
        },
        latency_ms: Latency { p50: error(&|r| r.latency_ms.p50), p99: error(&|r| r.latency_ms.p99) },
    }
}
