//! Peer detection against truth: rendered pictures of layouts drawn anew, and what the agent's detector says of them.
//!
//! Every layout is a room of its own ([`layout`]); one robot looks about in it for a second. The renderer's book of what each
//! pixel shows says how much of a robot could be seen; positions are known exactly ([`trial`]). Figures are by marker and
//! range ([`statistics`]), and by what stands before a robot ([`hidden`]).

pub mod hidden;
pub mod layout;
pub mod pictures;
pub mod statistics;
pub mod trial;

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::scenario::CameraSpec;
pub use statistics::Report;
use trial::{Eyes, Sighting, View};

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
    /// Of the robot that looks.
    pub camera: CameraSpec,
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
    /// Mean time of the detector, microseconds a picture.
    pub detector_us: f64,
}

/// Renders and looks; `each` is called after every layout.
pub fn run(plan: &Plan, each: &(dyn Fn() + Sync)) -> Result<Vec<Outcome>, PeersError> {
    let eyes = Eyes::of(&plan.camera)?;
    let next = AtomicUsize::new(0);
    let mut outcomes: Vec<(usize, Outcome)> = std::thread::scope(|scope| {
        let work = || {
            let mut done = Vec::new();
            loop {
                let n = next.fetch_add(1, Ordering::Relaxed);
                if n >= plan.layouts {
                    return done;
                }
                done.push((n, trial::look(&eyes, plan, plan.seed + n as u64)));
                each();
            }
        };
        let handles: Vec<_> = (0..plan.threads.max(1)).map(|_| scope.spawn(work)).collect();
        handles.into_iter().filter_map(|h| h.join().ok()).flatten().collect()
    });
    outcomes.sort_by_key(|(n, _)| *n);
    Ok(outcomes.into_iter().map(|(_, outcome)| outcome).collect())
}

#[cfg(test)]
mod tests;
