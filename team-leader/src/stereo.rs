//! Virtual stereo: two robots that know each other's pose are one stereo camera (report 5.1, `MATHS.md` §5.1, §5.4).
//!
//! `triangulate` has the report's closed forms with their covariance, `range_cue` what a single robot knows of a range,
//! `target` the filter that follows one moving object with bearings from any number of robots, `tails` how their
//! errors are spread, `motion` how place and velocity go on.

pub(crate) mod motion;
pub mod range_cue;
pub(crate) mod tails;
pub mod target;
pub mod triangulate;
