//! Mutual calibration and stereo against the Cramér–Rao bound, by Monte Carlo.
//!
//! The truth is a layout of robots and targets; what they measure follows from plain trigonometry ([`scene`]), which shares
//! nothing with the solver, and the bound from the numerical derivatives of that ([`bound`]), never from the solver's
//! Jacobian. Each draw adds noise, is given to `team_leader::solve` as a problem like any other, and its errors are held
//! against the bound (RMSE) and against the covariance that the solver states (NEES, NIS). Cases and seeds are fixed
//! ([`mod@cases`]).

pub mod bound;
pub mod cases;
pub mod plot;
pub mod reference;
pub mod scene;
pub mod statistics;
pub mod table;
pub mod trial;

pub use cases::{Case, Noise, cases};
pub use trial::{Outcome, Plan, run};
