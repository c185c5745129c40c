//! A chessboard, the object that cameras are calibrated with.

use std::fmt;

use nalgebra::{Vector2, Vector3};

use super::observation::View;

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

/// A board of known squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Inner corners.
    pub size: BoardSize,
    /// Side of a square, metres.
    pub square_m: f64,
}

/// Why a board cannot be, or corners are not its.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// Too few or too many corners.
    #[error(
        "a board of {0} inner corners: each side must have at least 2 and at most 100, and all together at least 6"
    )]
    Size(BoardSize),
    /// Not the side of a square.
    #[error("squares of {square_m} m: must be between 0.001 and 10 m (is the unit right?)")]
    Square {
        /// As given, metres.
        square_m: f64,
    },
    /// A view of another board.
    #[error("view {view:?} has {found} corners, a board of {size} has {}: is it another board?", size.corners())]
    Corners {
        /// The view's name.
        view: String,
        /// Corners in the view.
        found: usize,
        /// The board's.
        size: BoardSize,
    },
}

impl Board {
    /// Checks size and squares.
    ///
    /// # Errors
    /// Sides of less than 2 or more than 100 corners, or squares of an unlikely size.
    pub fn new(size: BoardSize, square_m: f64) -> Result<Self, BoardError> {
        if !(2..=100).contains(&size.cols) || !(2..=100).contains(&size.rows) || size.corners() < 6 {
            return Err(BoardError::Size(size));
        }
        if !(0.001..=10.0).contains(&square_m) {
            return Err(BoardError::Square { square_m });
        }
        Ok(Self { size, square_m })
    }

    /// A view of this board from its corners, row by row.
    ///
    /// # Errors
    /// Another number of corners than the board has.
    pub fn view(&self, name: String, corners: &[Vector2<f64>]) -> Result<View, BoardError> {
        if corners.len() != self.size.corners() {
            return Err(BoardError::Corners { view: name, found: corners.len(), size: self.size });
        }
        let place = |n: usize| {
            let (i, j) = (n % self.size.cols, n / self.size.cols);
            Vector3::new(i as f64 * self.square_m, j as f64 * self.square_m, 0.0)
        };
        Ok(View { name, points: corners.iter().enumerate().map(|(n, c)| (place(n), *c)).collect() })
    }
}
