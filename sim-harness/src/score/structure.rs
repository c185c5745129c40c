//! Whether the team's upright edges stand where something stands: every one is on the upright side of a wall or of a block.
//!
//! Which edges a room has nobody counts (each book has two); but where one is on the floor it is known: on an outline of the floor
//! plan. Its error along that outline cannot be told, that across can.

use nalgebra::{Matrix2, Vector2};
use protocol::frames::Pose2;
use serde::Serialize;
use team_leader::team_map::json::EdgeJson;

use super::nees::Nees;
use super::statistics::Rms;
use crate::world::World;

/// An edge further than this from every upright side is false, metres.
pub const GATE_M: f64 = 0.1;

/// Figures of the static structure at the end of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct StructureScores {
    /// Upright edges in the map.
    pub edges: usize,
    /// Of them nowhere near an upright side.
    pub false_edges: usize,
    /// Across the nearest upright side, of the others.
    pub rms_m: Option<f64>,
    /// The same over its variance.
    pub nees: Option<f64>,
    /// At 1 %.
    pub nees_bounds: Option<[f64; 2]>,
    /// For pooling over seeds.
    #[serde(skip)]
    pub sums: (Rms, Nees),
}

impl StructureScores {
    /// Of edges in the team's frame.
    pub fn of(edges: &[EdgeJson], world: &World, room_from_team: Pose2) -> Self {
        let sides = sides(world);
        let (mut scores, mut rms, mut nees) =
            (Self { edges: edges.len(), ..Self::default() }, Rms::default(), Nees::default());
        for edge in edges {
            let place = room_from_team.transform(Vector2::new(edge.x_m, edge.y_m));
            let turn = room_from_team.rotation();
            let [[xx, xy], [_, yy]] = edge.covariance;
            let covariance = turn * Matrix2::new(xx, xy, xy, yy) * turn.transpose();
            let nearest = sides.iter().filter(|s| s.overlaps(edge.z_m)).map(|s| s.offset(place));
            let Some(offset) = nearest.min_by(|a, b| a.norm().total_cmp(&b.norm())).filter(|o| o.norm() < GATE_M)
            else {
                scores.false_edges += 1;
                continue;
            };
            rms.add_square(offset.norm_squared());
            let across = offset.try_normalize(1e-9).unwrap_or_else(Vector2::x);
            nees.add(offset.norm_squared() / across.dot(&(covariance * across)).max(1e-12), 1);
        }
        scores.with((rms, nees))
    }

    fn with(self, (rms, nees): (Rms, Nees)) -> Self {
        Self { rms_m: rms.value(), nees: nees.mean(), nees_bounds: nees.bounds(), sums: (rms, nees), ..self }
    }

    /// Of several runs together.
    pub fn pooled<'a>(runs: impl Iterator<Item = &'a Self>) -> Self {
        let (mut all, mut rms, mut nees) = (Self::default(), Rms::default(), Nees::default());
        for run in runs {
            all.edges += run.edges;
            all.false_edges += run.false_edges;
            rms += run.sums.0;
            nees += run.sums.1;
        }
        all.with((rms, nees))
    }
}

impl std::fmt::Display for StructureScores {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} upright edges of what stands still, {} of them false", self.edges, self.false_edges)?;
        if let (Some(rms), Some(nees), Some([low, high])) = (self.rms_m, self.nees, self.nees_bounds) {
            write!(f, "; the others: {rms:.3} m RMS across their surface, NEES {nees:.2} [{low:.2} {high:.2}]")?;
        }
        Ok(())
    }
}

/// An upright side from above, and between which heights it is.
struct SideOf {
    ends: [Vector2<f64>; 2],
    z_m: [f64; 2],
}

impl SideOf {
    /// From its nearest point to `place`.
    fn offset(&self, place: Vector2<f64>) -> Vector2<f64> {
        let along = self.ends[1] - self.ends[0];
        let share = ((place - self.ends[0]).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        place - (self.ends[0] + share * along)
    }

    fn overlaps(&self, z_m: [f64; 2]) -> bool {
        self.z_m[0] < z_m[1] && z_m[0] < self.z_m[1]
    }
}

fn sides(world: &World) -> Vec<SideOf> {
    let of = |(corners, z_m): ([[f64; 2]; 4], [f64; 2])| {
        (0..4).map(move |k| SideOf { ends: [corners[k], corners[(k + 1) % 4]].map(Vector2::from), z_m })
    };
    world.outlines().into_iter().flat_map(of).collect()
}
