//! What a run left: all maps and observations, what the robots saw truly, traffic, latencies; and its score.

use std::sync::Arc;

use protocol::id::RobotId;
use protocol::message::{Observation, TeamMap};
use protocol::time::Timestamp;
use robot_agent::agent::{Frame, PictureKind};

use super::truth::{Glimpse, TruthKeeper};
use team_leader::team_map::json::EdgeJson;

use crate::bandwidth::{KindRate, VideoRate};
use crate::replay::Heard;
use crate::scenario::Scenario;
use crate::score::scores::Latency;
use crate::score::structure::StructureScores;
use crate::score::{MapErrors, Run, Scorer, Scores};
use crate::world::World;

/// All of a run.
#[derive(Debug)]
pub struct Outcome {
    /// What was to be simulated.
    pub scenario: Scenario,
    /// What was simulated.
    pub world: Arc<World>,
    /// Names of the robots, in the order of the world.
    pub names: Vec<RobotId>,
    /// How long.
    pub duration_s: f64,
    /// True time 0 on the leader's clock.
    pub zero: Timestamp,
    /// As published, in order.
    pub maps: Vec<TeamMap>,
    /// What stands still, as the leader has it at the end.
    pub edges: Vec<EdgeJson>,
    /// As they reached the leader.
    pub observations: Vec<(RobotId, Observation)>,
    /// All that reached the leader, in order (in virtual time only).
    pub heard: Vec<Heard>,
    /// Of each robot, in order of time.
    pub glimpses: Vec<Vec<Glimpse>>,
    /// From the arrival of an observation to its map.
    pub latency_ms: Latency,
    /// From a picture's capture to the map that holds it.
    pub capture_to_map_ms: Latency,
    /// Whether latency and wire bytes are computed.
    pub modelled: bool,
    /// By robot and kind.
    pub bandwidth: Vec<KindRate>,
    /// All robots together.
    pub video: VideoRate,
    /// The agents' pictures of the end, PNG.
    pub pictures: Vec<(PictureKind, RobotId, Vec<u8>)>,
    /// The last picture of each robot.
    pub frames: Vec<(RobotId, Frame)>,
    /// What agents and leader told people.
    pub notices: Vec<String>,
    /// Pictures that were not ready at their time (real time only).
    pub late_frames: u64,
}

/// The score and the errors of each map behind it.
#[derive(Debug)]
pub struct Scored {
    /// The figures.
    pub scores: Scores,
    /// One for each scored map with a frame.
    pub errors: Vec<MapErrors>,
    /// With the alignment.
    pub scorer: Scorer,
}

impl Outcome {
    /// True time of an instant on the leader's clock.
    pub fn true_time_s(&self, stamp: Timestamp) -> f64 {
        stamp.seconds_since(self.zero)
    }

    /// The truth, for maps and files.
    pub fn truth(&self) -> TruthKeeper<'_> {
        TruthKeeper::new(&self.world, &self.names, &self.glimpses, self.duration_s)
    }

    /// All maps against truth.
    pub fn score(&self) -> Scored {
        let truth = self.truth();
        let mut scorer = Scorer::default();
        let errors = self
            .maps
            .iter()
            .filter_map(|map| {
                let time_s = self.true_time_s(map.stamp);
                (time_s <= self.duration_s).then(|| scorer.add(&truth.at(time_s), map)).flatten()
            })
            .collect();
        let structure = scorer.room_from_team().map(|frame| StructureScores::of(&self.edges, &self.world, frame));
        let run = Run {
            scenario: self.scenario.name.clone(),
            seed: self.world.seed(),
            duration_s: self.duration_s,
            structure: structure.unwrap_or_default(),
            latency_ms: self.latency_ms.clone(),
            modelled: self.modelled,
            bandwidth: self.bandwidth.clone(),
            video: self.video,
        };
        Scored { scores: Scores::new(&scorer, run), errors, scorer }
    }
}
