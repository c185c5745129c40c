//! Calibration: what a camera's parameters are, how well they are known, and whether the model is right.
//!
//! ```text
//! pictures ─▶ corners ─┐
//! corner files ────────┴▶ observations ─▶ bundle (camera, poses) ─▶ selection ─▶ camera.toml, report
//! ```

pub mod axis;
pub mod bars;
pub mod board;
pub mod bundle;
pub mod candidate;
pub mod centre;
pub mod conversion;
pub mod corner_file;
pub mod corners;
pub mod floor;
pub mod formats;
pub mod free_camera;
mod gradient;
mod least_squares;
pub mod lines;
pub mod locus;
pub mod mounting;
pub mod observation;
pub mod radial;
pub mod report;
pub mod rim;
pub mod selection;
pub mod summary;
pub mod tilt;
pub mod verify;

pub use board::{Board, BoardSize};

#[cfg(test)]
mod reality;

/// A group of the golden numbers, which come from code that shares nothing with this project.
#[cfg(test)]
fn golden(group: &str) -> serde_json::Value {
    let all: serde_json::Value = serde_json::from_str(include_str!("../../tests/golden/golden.json")).unwrap();
    all[group].clone()
}
