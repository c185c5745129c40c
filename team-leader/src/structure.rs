//! The room: upright edges that several robots see (corners of walls, door frames, posts, sides of furniture), on the floor.
//!
//! Robots tell the bearings of such edges once they have stood for a while ([`protocol::message::Edges`]). What one of them saw
//! from a place stays a view from that place when it has driven on: the next place is one more view, so that a robot that comes
//! round gives stereo over time of what stands still. The views are matched anew whenever one comes ([`matching`]).

pub mod matching;

use nalgebra::{Matrix2, Matrix3, Vector2};
use protocol::frames::Pose2;
use protocol::message::Edges;

use crate::calibration::live::{Calibrator, Changes};
use matching::{Edge, Posed};

/// Most places from which is seen, and of one robot.
pub const MAX_VIEWS: usize = 8;
const MAX_VIEWS_OF_ROBOT: usize = 3;

/// An upright edge on the floor.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Where, in the team's frame.
    pub position: Vector2<f64>,
    /// With the poses' part, m².
    pub covariance: Matrix2<f64>,
    /// From where to where it was seen, metres above the floor; it may go on beyond.
    pub extent_m: [f64; 2],
    /// Robots that have seen it, each once.
    pub robots: Vec<usize>,
    /// Places from which it was seen: at least two.
    pub views: usize,
}

/// What a robot saw from a place.
#[derive(Debug)]
struct View {
    robot: usize,
    /// Height of the camera, metres.
    height_m: f64,
    edges: Vec<Edge>,
    /// Where it was seen from, with its covariance by itself, once the robot has left.
    left: Option<(Pose2, Matrix3<f64>)>,
}

/// The static structure round the robots of a component.
#[derive(Debug, Default)]
pub struct Structure {
    views: Vec<View>,
    landmarks: Vec<Landmark>,
}

impl Structure {
    /// What robots have seen together.
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// A standing robot tells what is round it.
    pub fn see(&mut self, robot: usize, height_m: f64, said: &Edges, calibrator: &Calibrator) {
        if calibrator.station(robot).is_none() {
            return;
        }
        let edges = said.edges.iter().map(Edge::of).collect();
        self.views.retain(|v| v.robot != robot || v.left.is_some());
        self.views.push(View { robot, height_m, edges, left: None });
        self.forget(|v| v.robot == robot, MAX_VIEWS_OF_ROBOT);
        self.forget(|_| true, MAX_VIEWS);
        self.landmarks = self.matched(calibrator);
    }

    /// Robots left their places: from there they have seen what they have seen.
    pub fn follow_changes(&mut self, changes: &Changes) {
        for (robot, pose, covariance) in &changes.left {
            for view in self.views.iter_mut().filter(|v| v.robot == *robot && v.left.is_none()) {
                view.left = Some((*pose, *covariance));
            }
        }
    }

    /// Drops the oldest of some views until there are no more than `most`.
    fn forget(&mut self, which: impl Fn(&View) -> bool, most: usize) {
        while self.views.iter().filter(|v| which(v)).count() > most {
            let Some(oldest) = self.views.iter().position(&which) else { return };
            self.views.remove(oldest);
        }
    }

    fn matched(&self, calibrator: &Calibrator) -> Vec<Landmark> {
        let posed = self.views.iter().filter_map(|v| {
            let (pose, covariance) = match v.left {
                Some(left) => left,
                None => (calibrator.station(v.robot)?, calibrator.covariance(v.robot, v.robot)),
            };
            let posed = Posed { robot: v.robot, pose, covariance, height_m: v.height_m, edges: &v.edges };
            Some((posed, v.left.is_none()))
        });
        let (posed, stands): (Vec<Posed<'_>>, Vec<bool>) = posed.unzip();
        // What a place that was left has to do with others is not known any more.
        let joint = |a: usize, b: usize| match (a == b, stands[a] && stands[b]) {
            (true, _) => posed[a].covariance,
            (false, true) => calibrator.covariance(posed[a].robot, posed[b].robot),
            (false, false) => Matrix3::zeros(),
        };
        matching::landmarks(&posed, &joint)
    }
}
