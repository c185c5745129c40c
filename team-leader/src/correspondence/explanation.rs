//! How well a set of tracks, one of each of several robots, is explained by one object on the floor.
//!
//! The object may be anywhere in the room (area A), so the likelihood of the bearings is an integral over the floor, about
//! the best place x̂ with covariance P (Laplace):
//!
//! ```text
//!  ln p = Σ ln t( θᵢ − θᵢ(x̂) ; σᵢ ) + ln( 2π √|P| / A )        two rays: D₁ D₂ / (A sin φ₀), `MATHS.md` §5.4
//! ```
//! To that comes what each robot alone knows of the range, and from it goes the density of clutter at each bearing.

use nalgebra::{Matrix2, Vector2};
use protocol::angle::wrap;
use protocol::frames::Pose2;
use protocol::time::Timestamp;

use super::Follower;
use super::memory::Memory;
use crate::calibration::kernel;
use crate::stereo::tails::log_student;
use crate::stereo::triangulate::{StereoBearings, triangulate};

/// Rays that meet at a flatter angle (sine) say nothing about range.
const LEAST_PARALLAX: f64 = 0.08;
/// Where objects may be, metres from each robot.
const RANGE_M: [f64; 2] = [0.35, 15.0];
/// One object is expected in so many square metres.
const AREA_M2: f64 = 40.0;
/// ln of how much wider ranges of clutter scatter than those of people: what a range at its best says for a person.
pub const RANGE_WORTH: f64 = 0.7;
/// What two tops at different heights cost at most, squared sigmas; a hand, a hat.
const MOST_TOP_COST: f64 = 9.0;
const TOP_M: f64 = 0.1;
/// What looks count for whether tracks are one object, and what two sights tell at most, nats.
const LOOKS_WORTH: f64 = 0.4;
const MOST_LOOKS: f64 = 4.0;
/// Steps of Gauss and Newton from where the two best rays meet.
const STEPS: usize = 3;

/// Where an object would be, and how much speaks for it.
#[derive(Debug, Clone, Copy)]
pub struct Explanation {
    /// One object against clutter, nats.
    pub log_ratio: f64,
    /// On the floor.
    pub position: Vector2<f64>,
    /// m², given exact poses.
    pub covariance: Matrix2<f64>,
}

impl Follower {
    /// One object for all these tracks at `at`; `None` where no place on the floor is.
    pub(super) fn explain(&self, tracks: &[(&Memory, Pose2)], at: Timestamp) -> Option<Explanation> {
        let rays: Vec<(Pose2, f64)> = tracks.iter().map(|(m, pose)| (*pose, m.bearing_at(at))).collect();
        let mut position = widest_crossing(&rays)?;
        let mut information = Matrix2::zeros();
        let mut rays = Vec::with_capacity(tracks.len());
        for step in 0..=STEPS {
            information = Matrix2::zeros();
            let mut gradient = Vector2::zeros();
            rays.clear();
            for (m, pose) in tracks {
                let from = [pose.x_m, pose.y_m, pose.heading_rad];
                let (bearing, _, to_point) = kernel::bearing(from, position.into());
                let range_m = (position - pose.position()).norm();
                if !(RANGE_M[0]..RANGE_M[1]).contains(&range_m) {
                    return None;
                }
                let var = self.config.bearing_var(m.sigma_rad, range_m);
                let residual = wrap(m.bearing_at(at) - bearing);
                let row = Vector2::from(to_point);
                information += row * row.transpose() / var;
                gradient += row * residual / var;
                rays.push((residual * residual / var, var, range_m));
            }
            if step < STEPS && tracks.len() > 2 {
                position += information.try_inverse()? * gradient;
            }
        }
        let covariance = information.try_inverse()?;
        let mut log_ratio = (std::f64::consts::TAU * covariance.determinant().max(0.0).sqrt() / AREA_M2).ln();
        for ((m, pose), (d2, var, range_m)) in tracks.iter().zip(&rays) {
            log_ratio += log_student(*d2, *var) + RANGE_WORTH - 0.5 * m.cue.cost(*range_m);
            log_ratio -= self.clutter(m.robot, pose, m.bearing_at(at), at, m.bound).ln();
        }
        let tops: Vec<(f64, f64)> = tracks
            .iter()
            .zip(&rays)
            .filter_map(|((m, _), (_, _, range_m))| m.top.map(|(e, s)| (range_m * e.tan(), range_m * s)))
            .collect();
        if let [(za, sa), (zb, sb), ..] = tops[..] {
            log_ratio -= 0.5 * ((za - zb) / sa.hypot(sb).hypot(TOP_M)).powi(2).min(MOST_TOP_COST);
        }
        let looks: Vec<_> = tracks.iter().filter_map(|(m, _)| m.appearance).collect();
        for (n, a) in looks.iter().enumerate() {
            for b in &looks[n + 1..] {
                let nats = a.log_ratio(b).clamp(-MOST_LOOKS, MOST_LOOKS);
                log_ratio += LOOKS_WORTH * nats / (looks.len() - 1) as f64;
            }
        }
        Some(Explanation { log_ratio, position, covariance })
    }
}

/// Where the two rays (pose and bearing) meet that meet at the largest angle.
pub fn widest_crossing(rays: &[(Pose2, f64)]) -> Option<Vector2<f64>> {
    let mut best: Option<(f64, Vector2<f64>)> = None;
    for (n, (pose_a, a)) in rays.iter().enumerate() {
        for (pose_b, b) in &rays[n + 1..] {
            let bearings = StereoBearings {
                target_1_rad: *a,
                target_2_rad: *b,
                bearing_21_rad: pose_a.bearing_to(pose_b.position()),
                bearing_12_rad: pose_b.bearing_to(pose_a.position()),
                baseline_m: (pose_b.position() - pose_a.position()).norm(),
            };
            // Rays of two robots that stand in line with it may part; others still meet.
            let Some(met) = triangulate(&bearings) else { continue };
            let sine = met.parallax_rad.sin();
            if sine > best.map_or(LEAST_PARALLAX, |(sine, _)| sine) {
                best = Some((sine, pose_a.transform(met.position_m)));
            }
        }
    }
    best.map(|(_, position)| position)
}
