//! The inner corners of a chessboard in a picture in which straight lines are curved.
//!
//! Problem: detectors for ordinary lenses look for straight lines or square quads; in a panoramic picture the squares are
//! bent, of very different sizes, and the rest of the room is full of other corners. Insight: a corner of a board is a
//! saddle of the gray values, its two edges are the directions without curvature, and neighbours on the board see the same
//! edge with bright and dark exchanged. So: saddles (`saddle`), linked from neighbour to neighbour only where both agree
//! on the edge, its polarity and the contrast along it, and labelled by walking the links (`grid`). What one blur does
//! not show, a wider one may.

mod grid;
mod saddle;

use crate::capture::GrayPicture;
use nalgebra::Vector2;

use super::BoardSize;

/// Blurs (standard deviation, pixels) that are tried in turn: small squares first.
const BLURS_PX: [f32; 3] = [1.0, 1.8, 3.0];

/// Why no complete board was found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BoardNotFound {
    /// Nothing like a board.
    #[error(
        "no board of {wanted} inner corners: {saddles} corner-like points, none of them linked to a grid (is the board in \
         view, lit and sharp?)"
    )]
    NoGrid {
        /// The board that was looked for.
        wanted: BoardSize,
        /// Points that look like the corner of a board.
        saddles: usize,
    },
    /// A part of a board.
    #[error(
        "no complete board of {wanted} inner corners: the largest grid has {found} ({corners} corners); is a part of the board \
         hidden, or is its size in inner corners another?"
    )]
    Incomplete {
        /// The board that was looked for.
        wanted: BoardSize,
        /// Extent of the largest grid.
        found: BoardSize,
        /// Its corners.
        corners: usize,
    },
    /// More than the board.
    #[error("the picture shows a board of at least {found} inner corners, not {wanted}: correct the board's size")]
    Larger {
        /// The board that was looked for.
        wanted: BoardSize,
        /// Extent of the grid that is there.
        found: BoardSize,
    },
}

/// The board's inner corners, row by row (`size.cols` a row), in pixels. In the picture the step to the next row is
/// clockwise (u to v) from the step to the next column; which of the board's two ends comes first is arbitrary.
///
/// # Errors
/// No complete board of this size is in the picture; the reason says what was found instead.
pub fn find_board(picture: &GrayPicture, size: BoardSize) -> Result<Vec<Vector2<f64>>, BoardNotFound> {
    let mut best: Option<BoardNotFound> = None;
    for blur_px in BLURS_PX {
        let surface = saddle::Surface::new(picture, blur_px);
        let saddles = surface.saddles();
        match grid::find(&surface, &saddles, size) {
            Ok(corners) => return Ok(refined(picture, &corners, size)),
            Err(reason) => {
                if best.as_ref().is_none_or(|b| reason.corners() > b.corners()) {
                    best = Some(reason);
                }
            }
        }
    }
    Err(best.unwrap_or(BoardNotFound::NoGrid { wanted: size, saddles: 0 }))
}

impl BoardNotFound {
    fn corners(&self) -> usize {
        match self {
            Self::NoGrid { .. } => 0,
            Self::Incomplete { corners, .. } => *corners,
            Self::Larger { found, .. } => found.cols * found.rows,
        }
    }
}

/// Each corner from the unblurred picture, in as wide a window as its neighbours leave.
fn refined(picture: &GrayPicture, corners: &[Vector2<f64>], size: BoardSize) -> Vec<Vector2<f64>> {
    let at = |i: usize, j: usize| corners[j * size.cols + i];
    (0..corners.len())
        .map(|index| {
            let (i, j) = (index % size.cols, index / size.cols);
            let here = at(i, j);
            let mut nearest = f64::INFINITY;
            if i > 0 {
                nearest = nearest.min((at(i - 1, j) - here).norm());
            }
            if i + 1 < size.cols {
                nearest = nearest.min((at(i + 1, j) - here).norm());
            }
            if j > 0 {
                nearest = nearest.min((at(i, j - 1) - here).norm());
            }
            if j + 1 < size.rows {
                nearest = nearest.min((at(i, j + 1) - here).norm());
            }
            saddle::refine(picture, here, nearest).unwrap_or(here)
        })
        .collect()
}

#[cfg(test)]
mod tests;
