//! One robot's agent on rendered frames with truth: people who meet and part, cross the seam while they are one blob, stand
//! still; light that is switched or fades; a robot that turns; somebody who walks away from 0.8 to 6 m.
//!
//! A case and a seed give a scenario (`cases`); the real agent works its frames whole (`trial`); what it said is compared
//! with what was so (`score`). Only pictures, their times and the camera file reach the agent.

pub mod cases;
pub mod score;
pub mod trial;
pub mod verdict;

pub use cases::Case;
pub use score::Tally;
pub use trial::{Trial, TrialError, run, run_scenario};
pub use verdict::Claim;
