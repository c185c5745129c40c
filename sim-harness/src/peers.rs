//! Peer detection against truth: rendered pictures of layouts drawn anew, and what the agent's detector says of them.
//!
//! Every layout is a room of its own ([`layout`]); one robot looks about in it for a second. The renderer's book of what each
//! pixel shows says how much of a robot could be seen; positions are known exactly ([`trial`]). Figures are by marker and
//! range ([`statistics`]), and by what stands before a robot ([`hidden`]). What was fitted teaches what tells robots from other
//! things ([`verdict`]).

mod boost;
pub mod hidden;
pub mod layout;
mod net;
pub mod pictures;
pub mod statistics;
pub mod trial;
pub mod verdict;

use robot_agent::peers::Traits;

use crate::parallel;
use crate::scenario::CameraSpec;
pub use layout::Team;
pub use statistics::Report;
use trial::{Eyes, Sighting, View};
use verdict::Example;

/// What is to be rendered.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Layouts.
    pub layouts: usize,
    /// Pictures of each, 10 Hz.
    pub pictures: usize,
    /// Of the first layout; each has the next.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
    /// Whether there are any robots to see: without, every sighting is a false one.
    pub robots: bool,
    /// What they wear.
    pub team: Team,
    /// Of the robot that looks.
    pub camera: CameraSpec,
}

impl Plan {
    /// The robots of a layout that may be seen.
    fn seen(&self) -> Option<Team> {
        self.robots.then_some(self.team)
    }
}

/// Why there are no figures or pictures.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct PeersError(String);

/// One layout's outcome.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// That it was drawn with.
    pub seed: u64,
    /// What there was to see, a list a picture.
    pub views: Vec<Vec<View>>,
    /// What was sighted, a list a picture.
    pub sightings: Vec<Vec<Sighting>>,
    /// The likeliest of what was fitted where each robot is, a list a picture.
    pub likeliest: Vec<Vec<Option<Traits>>>,
    /// What the detector fitted cylinders and plates to, labelled.
    pub fits: Vec<Example>,
    /// Mean time of the detector, microseconds a picture.
    pub detector_us: f64,
}

/// Renders and looks; `each` is called after every layout.
pub fn run(plan: &Plan, each: &(dyn Fn() + Sync)) -> Result<Vec<Outcome>, PeersError> {
    let eyes = Eyes::of(&plan.camera)?;
    Ok(parallel::map(plan.threads, 0..plan.layouts, |n| {
        let outcome = trial::look(&eyes, plan, plan.seed + n as u64);
        each();
        outcome
    }))
}

#[cfg(test)]
mod tests;
