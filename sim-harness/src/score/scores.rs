//! The figures of one run, in the form of `DESIGN.md` §6, with what else people want to know under further keys.

use serde::Serialize;

use super::Scorer;
use super::nees::Nees;
use super::statistics::{mean, percentile};
use super::structure::StructureScores;
use crate::bandwidth::{KindRate, VideoRate};

/// What is known of a run beside its maps.
#[derive(Debug, Clone, Default)]
pub struct Run {
    /// Name of the scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// How long it ran.
    pub duration_s: f64,
    /// Of the team's map of what stands still.
    pub structure: StructureScores,
    /// From the arrival of an observation to the map that holds it.
    pub latency_ms: Latency,
    /// Whether latency is virtual time and wire bytes are computed.
    pub modelled: bool,
    /// Traffic by robot and kind.
    pub bandwidth: Vec<KindRate>,
    /// What the pictures themselves would cost, all robots together.
    pub video: VideoRate,
}

/// Figures of one run. `None` (JSON null) where nothing could be measured.
#[derive(Debug, Clone, Serialize)]
pub struct Scores {
    /// Name of the scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// How long it ran.
    pub duration_s: f64,
    /// Poses.
    pub robots: RobotScores,
    /// People.
    pub targets: TargetScores,
    /// What stands still.
    pub structure: StructureScores,
    /// From the arrival of an observation to the map that holds it.
    pub latency_ms: Latency,
    /// Traffic.
    pub bandwidth: Vec<KindRate>,
    /// What the pictures themselves would cost, all robots together.
    pub video: VideoRate,
    /// Whether latency is virtual time and wire bytes are computed.
    pub modelled: bool,
}

/// Standing robots but the gauge.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RobotScores {
    /// Of those that stand all the time.
    pub position_rms_m: Option<f64>,
    /// Of those that stand all the time.
    pub heading_rms_deg: Option<f64>,
    /// Joint, of all.
    pub nees: Option<f64>,
    /// At 1 %.
    pub nees_bounds: Option<[f64; 2]>,
    /// Robots that drive in the run, at all times.
    pub driving: Driving,
    /// Share of robot-instants with a pose.
    pub placed: Option<f64>,
    /// For pooling over seeds.
    #[serde(skip)]
    pub nees_sum: Nees,
}

/// A robot that drives.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Driving {
    /// At all times.
    pub position_rms_m: Option<f64>,
    /// At all times.
    pub heading_rms_deg: Option<f64>,
    /// While it moves.
    pub moving_position_rms_m: Option<f64>,
    /// While it moves.
    pub moving_heading_rms_deg: Option<f64>,
}

/// People.
#[derive(Debug, Clone, Default, Serialize)]
pub struct TargetScores {
    /// Of all matched.
    pub rms_m: Option<f64>,
    /// Matched among coverable.
    pub coverage: Option<f64>,
    /// Mean over the maps.
    pub gospa_m: Option<f64>,
    /// As in CLEAR-MOT.
    pub id_switches: usize,
    /// Targets that mostly follow nobody.
    pub false_tracks: usize,
    /// Of all matched.
    pub nees: Option<f64>,
    /// At 1 %.
    pub nees_bounds: Option<[f64; 2]>,
    /// Of those matched within 5 m of the two nearest robots.
    pub rms_within_5m_m: Option<f64>,
    /// For pooling over seeds.
    #[serde(skip)]
    pub nees_sum: Nees,
}

/// Milliseconds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Latency {
    /// Median.
    pub p50: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
}

impl Latency {
    /// Of all latencies of a run.
    pub fn of(latencies_ms: &[f64]) -> Self {
        Self { p50: percentile(latencies_ms, 0.5), p99: percentile(latencies_ms, 0.99) }
    }
}

impl Scores {
    /// The figures of all maps that a scorer took in.
    pub fn new(scorer: &Scorer, run: Run) -> Self {
        let sums = &scorer.sums;
        let share = |[part, whole]: [usize; 2]| (whole > 0).then(|| part as f64 / whole as f64);
        Self {
            scenario: run.scenario,
            seed: run.seed,
            duration_s: run.duration_s,
            robots: RobotScores {
                position_rms_m: sums.standing[0].value(),
                heading_rms_deg: sums.standing[1].value(),
                nees: sums.robot_nees.mean(),
                nees_bounds: sums.robot_nees.bounds(),
                driving: Driving {
                    position_rms_m: sums.driving[0].value(),
                    heading_rms_deg: sums.driving[1].value(),
                    moving_position_rms_m: sums.driving_now[0].value(),
                    moving_heading_rms_deg: sums.driving_now[1].value(),
                },
                placed: share(sums.placed),
                nees_sum: sums.robot_nees,
            },
            targets: TargetScores {
                rms_m: sums.targets.value(),
                coverage: share(sums.covered),
                gospa_m: mean(&sums.gospa_m),
                id_switches: scorer.identity.switches(),
                false_tracks: scorer.lives.values().filter(|(matched, all)| 2 * matched < *all).count(),
                nees: sums.target_nees.mean(),
                nees_bounds: sums.target_nees.bounds(),
                rms_within_5m_m: sums.near_targets.value(),
                nees_sum: sums.target_nees,
            },
            structure: run.structure,
            latency_ms: run.latency_ms,
            bandwidth: run.bandwidth,
            video: run.video,
            modelled: run.modelled,
        }
    }
}
