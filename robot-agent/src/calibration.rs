//! Calibration: what a camera's parameters are, how well they are known, and whether the model is right.
//!
//! ```text
//! pictures ─▶ corners ─┐
//! corner files ────────┴▶ observations ─▶ bundle (model, poses) ─▶ selection ─▶ camera.toml, report
//! ```

pub mod corner_file;
pub mod corners;

use std::fmt;

/// Inner corners of a chessboard: where four squares meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardSize {
    /// Corners along a row.
    pub cols: usize,
    /// Rows of corners.
    pub rows: usize,
}

impl BoardSize {
    /// Number of inner corners.
    pub fn corners(&self) -> usize {
        self.cols * self.rows
    }
}

impl fmt::Display for BoardSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.cols, self.rows)
    }
}

#[cfg(test)]
mod reality;
