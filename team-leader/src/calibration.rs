//! Mutual calibration: where the robots stand, from how they see each other.
//!
//! Problem: N robots that look alike see each other as bearings and apparent widths. Who is who, and where? (Report 5.2,
//! widened to N robots; `MATHS.md` §5.5.)
//!
//! ```text
//!  sightings of one frame ──▶ slot (one place where an observer sees a robot, averaged while both stand)
//!                               │
//!                          naming (which robot each slot is, by mutual consistency; or "ambiguous")
//!                               │ links: slots with both names
//!        robot stands ──▶ block (joint Gauss-Newton over all standing robots, prior from everything before)
//!        robot moves  ──▶ rover (own filter, conditional on the block) ──▶ stands again: back into the block
//!        nobody stands, all have odometry ──▶ convoy (one filter over all)
//! ```
//!
//! Why averages instead of a filter: a sighting has a white error, which averages out, and one that is fixed by the
//! geometry of the two robots (optics, edges, lamps), which does not. While both stand there is one average with one fixed
//! error; a recursive filter would count that error again with every frame and become certain of something wrong.

pub mod block;
pub mod closed_form;
pub mod convoy;
pub mod kernel;
pub mod live;
pub mod naming;
pub mod rover;
pub mod slot;
pub mod systematic;
