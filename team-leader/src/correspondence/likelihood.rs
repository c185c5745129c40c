//! How well a track fits a target, in nats: log-likelihood that it is the target's, less that it is clutter.
//!
//! Residuals have heavy tails ([`crate::stereo::tails`]): one far off costs little more than clutter. Clutter is what robots follow that is
//! nobody: a few tracks anywhere in the picture, and pieces of bodies beside the bodies they belong to.

use std::f64::consts::TAU;

use protocol::angle::wrap;
use protocol::id::TargetId;

use protocol::message::{TrackObservation, TrackState};

use super::{Follower, Frame, PRESENT_S};

/// Tracks of nobody in a picture, and pieces of a body beside it that have a track of their own.
const CLUTTER: f64 = 0.5;
const PIECES: f64 = 0.4;
const PIECES_OF_TRACKS: f64 = 0.6;
/// How far from a body's axis its pieces lie, standard deviation in metres.
const PIECE_M: f64 = 0.2;

/// Density of tracks of nobody (1/rad) at a track's bearing: anywhere, and pieces of the bodies that the robot follows beside it.
pub fn clutter_of_tracks(frame: &Frame<'_>, track: &TrackObservation) -> f64 {
    let mut density = CLUTTER / TAU;
    let others = frame.tracks.iter().filter(|o| o.track != track.track && o.state != TrackState::Hidden);
    for other in others {
        let half = 0.5 * other.width.rad().abs();
        let sigma = half.clamp(0.03, 0.4);
        let off = wrap(track.bearing.rad() - other.bearing.rad()) / sigma;
        density += PIECES_OF_TRACKS * (-0.5 * off * off).exp() / (sigma * TAU.sqrt());
    }
    density
}

impl Follower {
    /// Density of tracks (1/rad) at a bearing that are no further person: anywhere, and pieces of the targets that the robot
    /// follows, but for target `except`.
    pub(super) fn clutter(
        &self,
        robot: usize,
        pose: &protocol::frames::Pose2,
        bearing_rad: f64,
        at: protocol::time::Timestamp,
        except: Option<TargetId>,
    ) -> f64 {
        let mut density = CLUTTER / TAU;
        for followed in self.targets.iter().filter(|f| Some(f.id) != except) {
            if !followed.state.is_seen_by(robot, at, PRESENT_S) {
                continue;
            }
            let away = followed.state.target.position() - pose.position();
            let sigma = (PIECE_M / away.norm().max(0.3)).min(0.5);
            let off = wrap(bearing_rad - pose.bearing_to(followed.state.target.position())) / sigma;
            density += PIECES * (-0.5 * off * off).exp() / (sigma * TAU.sqrt());
        }
        density
    }
}
