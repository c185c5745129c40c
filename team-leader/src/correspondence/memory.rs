//! What is remembered of a track of one robot, and whose it is.

use protocol::angle::wrap;
use protocol::appearance::Appearance;
use protocol::id::{TargetId, TrackId};
use protocol::time::Timestamp;

use super::{Follower, Frame, MAX_MEMORIES, Sight};
use crate::stereo::range_cue::RangeCue;

/// A track unseen for longer is forgotten, seconds.
const FORGOTTEN_S: f64 = 5.0;

/// What somebody in doubt looked like holds for so long, seconds.
const FRESH_S: f64 = 1.0;

/// A track of one robot.
#[derive(Debug, Clone)]
pub struct Memory {
    /// Whose.
    pub robot: usize,
    /// Its number there.
    pub track: TrackId,
    /// Last seen.
    pub last: Timestamp,
    /// Last bearing, rad.
    pub bearing_rad: f64,
    /// How fast it changes, rad/s.
    pub rate_radps: f64,
    /// Standard deviation of the bearing, rad.
    pub sigma_rad: f64,
    /// Half of its width, rad.
    pub half_width_rad: f64,
    /// It was with others of late, and may be somebody else than before.
    pub doubtful: bool,
    /// In one region with others.
    pub merged: bool,
    /// A moving fellow robot explains it.
    pub peer: bool,
    /// What its robot knows of the range.
    pub cue: RangeCue,
    /// Elevation of the top and its sigma.
    pub top: Option<(f64, f64)>,
    /// What it looks like, as last told.
    pub appearance: Option<Appearance>,
    /// When that was.
    pub told: Timestamp,
    /// Height of the camera that sees it, m.
    pub camera_height_m: f64,
    /// Frames in which it was seen.
    pub count: u32,
    /// Whose it is.
    pub bound: Option<TargetId>,
    /// Frames in which it was that one's, apart from others and beyond doubt.
    pub tenure: u32,
}

impl Memory {
    /// Whether it is this one.
    pub fn is(&self, robot: usize, track: TrackId) -> bool {
        self.robot == robot && self.track == track
    }

    /// It is somebody's from now on.
    pub fn bind(&mut self, to: Option<TargetId>) {
        if self.bound != to {
            (self.bound, self.tenure) = (to, 0);
        }
    }

    /// Bearing at `at`, with the rate of late.
    pub fn bearing_at(&self, at: Timestamp) -> f64 {
        wrap(self.bearing_rad + self.rate_radps * at.seconds_since(self.last).clamp(-0.3, 0.3))
    }
}

impl Follower {
    /// Notes the frame's tracks; bindings of tracks that the robot only predicts live on.
    pub(super) fn remember(&mut self, frame: &Frame<'_>, sights: &[Sight]) {
        for sight in sights {
            let found = self.memories.iter_mut().find(|m| m.is(frame.robot, sight.track));
            let Some(m) = found else {
                if self.memories.len() < MAX_MEMORIES {
                    self.memories.push(Memory {
                        robot: frame.robot,
                        track: sight.track,
                        last: frame.at,
                        bearing_rad: sight.bearing_rad,
                        rate_radps: 0.0,
                        sigma_rad: sight.sigma_rad,
                        half_width_rad: sight.half_width_rad,
                        doubtful: sight.doubtful,
                        merged: sight.merged,
                        peer: sight.peer,
                        cue: sight.cue,
                        top: sight.top,
                        appearance: sight.appearance,
                        told: frame.at,
                        camera_height_m: frame.camera.height_m,
                        count: 1,
                        bound: None,
                        tenure: 0,
                    });
                }
                continue;
            };
            let dt = frame.at.seconds_since(m.last);
            if dt > 1e-3 {
                let rate = wrap(sight.bearing_rad - m.bearing_rad) / dt;
                m.rate_radps += 0.3 * (rate.clamp(-3.0, 3.0) - m.rate_radps);
            }
            (m.last, m.bearing_rad, m.sigma_rad) = (frame.at, sight.bearing_rad, sight.sigma_rad);
            if sight.appearance.is_some() {
                (m.appearance, m.told) = (sight.appearance, frame.at);
            } else if sight.doubtful && (!m.doubtful || frame.at.seconds_since(m.told) > FRESH_S) {
                // What it looked like before says nothing of who it is now.
                m.appearance = None;
            }
            m.doubtful = sight.doubtful;
            (m.half_width_rad, m.merged, m.peer) = (sight.half_width_rad, sight.merged, sight.peer);
            m.top = sight.top;
            m.count += 1;
            m.tenure += u32::from(m.bound.is_some() && !sight.merged && !sight.doubtful);
            if !sight.merged {
                m.cue = sight.cue;
            }
        }
        let newest = self.newest;
        let hidden = |m: &Memory| m.robot == frame.robot && frame.tracks.iter().any(|t| t.track == m.track);
        self.memories.retain(|m| hidden(m) || newest.seconds_since(m.last) < FORGOTTEN_S);
    }
}
