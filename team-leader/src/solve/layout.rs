//! The numbers of a problem, and which of them are unknown.
//!
//! Unknowns are ordered robots first, then targets, each with up to five numbers. No measurement joins two targets, so the
//! information matrix is an arrow, which [`super::joint`] makes use of:
//!
//! ```text
//!   robots  │ A   W₁  W₂ …
//!   target 1│ W₁ᵀ H₁
//!   target 2│ W₂ᵀ     H₂
//! ```

use protocol::angle::wrap;

/// Numbers of a robot: x, y (m), heading (rad), bearing bias (rad: added to every bearing it measures), time offset (s: its
/// stamps are late by it).
pub const ROBOT: usize = 5;
/// Numbers of a target: x, y, z (m) at its reference time, and velocity x, y (m/s).
pub const TARGET: usize = 5;

/// Unknowns and knowns of a problem.
#[derive(Debug, Clone)]
pub struct State {
    /// Of the robots.
    pub poses: Vec<[f64; ROBOT]>,
    /// Of the targets.
    pub points: Vec<[f64; TARGET]>,
}

/// A priori sigma of a robot's bias (rad) and time offset (s), where they are unknowns.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Nuisance {
    /// Of the bias; `None`: there is none.
    pub bias_rad: Option<f64>,
    /// Of the offset; `None`: there is none.
    pub offset_s: Option<f64>,
}

/// Which numbers of the state are unknown, in the order of the columns.
#[derive(Debug, Clone, Default)]
pub struct Layout {
    /// Columns of each robot's numbers.
    pub robots: Vec<[Option<usize>; ROBOT]>,
    /// Columns of each target's numbers.
    pub targets: Vec<[Option<usize>; TARGET]>,
    /// Column and sigma of unknowns that are known to be near zero a priori.
    pub priors: Vec<(usize, usize, usize, f64)>,
    /// Columns of robots; the targets' follow.
    pub robot_unknowns: usize,
    /// All columns.
    pub unknowns: usize,
}

impl Layout {
    /// `held`: robots of known pose; `nuisances`: of each robot; `free`: which numbers of each target are unknown.
    pub fn new(held: &[bool], nuisances: &[Nuisance], free: &[[bool; TARGET]]) -> Self {
        Self::with_places(held, nuisances, &vec![None; held.len()], free)
    }

    /// The same with robots that are another one at a later place (`earlier`, which stands before them): they share its bias and
    /// its time offset.
    pub fn with_places(
        held: &[bool],
        nuisances: &[Nuisance],
        earlier: &[Option<usize>],
        free: &[[bool; TARGET]],
    ) -> Self {
        let mut layout = Self::default();
        let mut next = 0;
        let mut column = |free: bool| {
            next += usize::from(free);
            free.then(|| next - 1)
        };
        for (robot, ((held, nuisance), earlier)) in held.iter().zip(nuisances).zip(earlier).enumerate() {
            if let Some(earlier) = earlier {
                let place = [!held; 3].map(&mut column);
                let before: [Option<usize>; ROBOT] = layout.robots[*earlier];
                layout.robots.push([place[0], place[1], place[2], before[3], before[4]]);
                continue;
            }
            let columns =
                [!held, !held, !held, nuisance.bias_rad.is_some(), nuisance.offset_s.is_some()].map(&mut column);
            for (k, sigma) in [(3, nuisance.bias_rad), (4, nuisance.offset_s)] {
                if let (Some(c), Some(sigma)) = (columns[k], sigma) {
                    layout.priors.push((c, robot, k, sigma));
                }
            }
            layout.robots.push(columns);
        }
        layout.targets = Vec::with_capacity(free.len());
        let robots = layout.robots.iter().flatten().flatten().max().map_or(0, |last| last + 1);
        for free in free {
            layout.targets.push(free.map(&mut column));
        }
        layout.robot_unknowns = robots;
        layout.unknowns = next;
        layout
    }

    /// Adds `step` to the unknowns.
    pub fn step(&self, state: &State, step: &[f64]) -> State {
        let mut moved = state.clone();
        for (columns, pose) in self.robots.iter().zip(&mut moved.poses) {
            add(columns, step, pose);
            pose[2] = wrap(pose[2]);
        }
        for (columns, point) in self.targets.iter().zip(&mut moved.points) {
            add(columns, step, point);
        }
        moved
    }
}

fn add(columns: &[Option<usize>; 5], step: &[f64], numbers: &mut [f64; 5]) {
    for (column, number) in columns.iter().zip(numbers) {
        *number += column.map_or(0.0, |c| step[c]);
    }
}
