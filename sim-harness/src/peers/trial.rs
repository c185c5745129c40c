//! One layout: what there was to see in each picture, and what was sighted.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector2;
use protocol::id::RobotId;
use robot_agent::optics::{CameraFile, MountedCamera};
use robot_agent::panorama::{Lut, PanoramaGeometry};
use robot_agent::peers::{Fit, Grid, Peer, PeerDetector, Traits};

use super::{Outcome, PeersError, Plan, layout, verdict};
use crate::render::Renderer;
use crate::render::rays::Rays;
use crate::scenario::{CameraSpec, WearSpec};
use crate::world::{RobotState, State};

/// Between two pictures.
const PERIOD_S: f64 = 0.1;
/// From this share on a robot is unhidden (its own mast hides a few pixels).
const WHOLE: f64 = 0.96;
/// Who hides a part of a robot is this near to the line of sight, metres.
const BESIDE_M: f64 = 0.5;

/// A camera from both sides: traced, and as the agent has it.
pub struct Eyes {
    spec: CameraSpec,
    rays: Arc<Rays>,
    camera: MountedCamera,
    geometry: PanoramaGeometry,
    lut: Lut,
    pub(super) grid: Grid,
}

impl Eyes {
    /// Of a design.
    pub fn of(spec: &CameraSpec) -> Result<Self, PeersError> {
        let failed = |e: &dyn std::fmt::Display| PeersError(format!("the camera cannot be used: {e}"));
        let camera = CameraFile::parse(&spec.toml(), "camera.toml".as_ref())
            .and_then(|file| file.mount())
            .map_err(|e| failed(&e))?;
        let geometry = PanoramaGeometry::for_camera(&camera).map_err(|e| failed(&e))?;
        let grid = Grid::of(&geometry).ok_or_else(|| failed(&"no cylinder panorama"))?;
        let (rays, lut) = (Arc::new(Rays::trace(spec)), Lut::panorama(&camera, &geometry));
        Ok(Self { spec: spec.clone(), rays, camera, geometry, lut, grid })
    }
}

/// Kinds of marker that figures are kept apart of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Rings.
    Cylinder,
    /// Equal bars.
    Bars,
    /// Bars that say who it is.
    CodedBars,
    /// A plate.
    Rectangle,
}

impl Kind {
    /// Of what a robot wears.
    pub fn of(wear: &WearSpec) -> Self {
        match wear {
            WearSpec::Rings => Self::Cylinder,
            WearSpec::Bars { code: None, .. } => Self::Bars,
            WearSpec::Bars { .. } => Self::CodedBars,
            WearSpec::Plate { .. } => Self::Rectangle,
        }
    }

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cylinder => "cylinder",
            Self::Bars => "bars",
            Self::CodedBars => "coded bars",
            Self::Rectangle => "rectangle",
        }
    }
}

/// What stands before a robot and hides a part of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Before {
    /// All but a few pixels can be seen.
    Nothing,
    /// A person.
    Person,
    /// Another robot.
    Robot,
    /// Furniture.
    Thing,
}

/// A robot as it could be seen in one picture.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Who.
    pub robot: RobotId,
    /// What it wears.
    pub kind: Kind,
    /// Truth, in the observer's body frame.
    pub bearing_rad: f64,
    /// Truth.
    pub range_m: f64,
    /// Its heading minus the observer's.
    pub heading_rad: f64,
    /// Angle between the marker's front and the line to the observer, 0 … π.
    pub turn_rad: f64,
    /// Unhidden share of the part with the marker, and its pixels if nothing hid it.
    pub visible: f64,
    /// See `visible`.
    pub pixels: u32,
    /// Why no more of it is to be seen.
    pub before: Before,
}

impl View {
    /// From where a sighting says it is, along the floor, metres.
    pub(super) fn apart_m(&self, peer: &Peer) -> f64 {
        let side = 2.0 * (0.5 * turned(self.bearing_rad - peer.bearing_rad)).sin();
        ((self.range_m - peer.range_m).powi(2) + self.range_m * peer.range_m * side * side).sqrt()
    }

    /// Whether what is sighted is near enough to be it.
    pub(super) fn may_be(&self, peer: &Peer) -> bool {
        self.apart_m(peer) < 0.2 + 0.05 * self.range_m
    }
}

/// What the detector said.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// As it came.
    pub peer: Peer,
    /// Which view it is of, by place in the picture's list.
    pub view: Option<usize>,
}

/// A picture of a layout, unwarped.
pub(super) fn panorama(eyes: &Eyes, plan: &Plan, seed: u64, picture: usize) -> Option<image::GrayImage> {
    let (_, world) = layout::draw(&eyes.spec, seed, PERIOD_S * plan.pictures as f64, plan.seen())?;
    let picture = Renderer::of_first(&Arc::new(world), &eyes.rays).render(PERIOD_S * picture as f64);
    let mut panorama = vec![0; eyes.geometry.pixels()];
    eyes.lut.unwarp(&picture.gray, &mut panorama).ok()?;
    image::GrayImage::from_raw(eyes.geometry.width(), eyes.geometry.height(), panorama)
}

/// What the first robot of a scenario sees of its fellows in so many pictures, 10 a second, as its agent does: followed, with names.
#[cfg(test)]
pub fn follow(eyes: &Eyes, scenario: &crate::scenario::Scenario, pictures: usize) -> Vec<Vec<Peer>> {
    let Ok(world) = crate::world::World::new(scenario, 1) else { return Vec::new() };
    let mut renderer = Renderer::of_first(&Arc::new(world), &eyes.rays);
    let fellows: Vec<_> = scenario.robot_ids().iter().skip(1).map(|id| (Some(*id), scenario.marker_of(id))).collect();
    let mut detector = PeerDetector::for_team(&eyes.camera, eyes.grid, &fellows);
    let mut panorama = vec![0; eyes.geometry.pixels()];
    let look = |n: usize| {
        let time_s = PERIOD_S * n as f64;
        let gray = renderer.render(time_s).gray;
        let _ = eyes.lut.unwarp(&gray, &mut panorama);
        detector.follow(&gray, &panorama, protocol::time::Timestamp::from_secs_f64(1.0 + time_s))
    };
    (0..pictures).map(look).collect()
}

/// Renders a layout's pictures and looks for robots in them.
pub fn look(eyes: &Eyes, plan: &Plan, seed: u64) -> Outcome {
    let pictures = plan.pictures;
    let mut outcome = Outcome {
        seed,
        views: Vec::new(),
        sightings: Vec::new(),
        likeliest: Vec::new(),
        fits: Vec::new(),
        detector_us: 0.0,
    };
    let drawn = layout::draw(&eyes.spec, seed, PERIOD_S * pictures as f64, plan.seen());
    let Some((scenario, world)) = drawn else { return outcome };
    let world = Arc::new(world);
    let mut renderer = Renderer::of_first(&world, &eyes.rays);
    let mut fellows: Vec<(Option<RobotId>, protocol::marker::Marker)> =
        scenario.robot_ids().iter().skip(1).map(|id| (Some(*id), scenario.marker_of(id))).collect();
    // The team has fellows elsewhere: the detector must not take one for another, or anything else for them.
    for (n, wear) in plan.team.worn().iter().enumerate() {
        let marker = wear.marker(None);
        if fellows.iter().all(|(_, m)| *m != marker) {
            fellows.push((RobotId::new(&format!("away{n}")).ok(), marker));
        }
    }
    let mut detector = PeerDetector::for_team(&eyes.camera, eyes.grid, &fellows);
    detector.take_fits();
    let mut panorama = vec![0; eyes.geometry.pixels()];
    let first = world.at(0.0);
    let mut spent_us = 0.0;
    for n in 0..pictures {
        let time_s = PERIOD_S * n as f64;
        let presence = renderer.presence(time_s);
        let picture = renderer.render(time_s);
        let state = world.at(time_s);
        let views: Vec<View> = (1..world.robots().len())
            .map(|n| {
                let id = world.robots()[n].id;
                let view =
                    view(&first.robots[0], &first.robots[n], Kind::of(&scenario.robots.wear_of(&id)), &presence[n]);
                View { before: before(&state, n, view.visible), ..view }
            })
            .collect();
        if eyes.lut.unwarp(&picture.gray, &mut panorama).is_err() {
            continue;
        }
        let start = Instant::now();
        let peers = detector.detect(&picture.gray, &panorama);
        spent_us += start.elapsed().as_secs_f64() * 1e6;
        let fits = detector.take_fits();
        outcome.likeliest.push(views.iter().map(|view| likeliest(view, &fits)).collect());
        outcome.fits.extend(verdict::label(seed, n, fits, &views));
        outcome.sightings.push(matched(peers, &views));
        outcome.views.push(views);
    }
    outcome.detector_us = spent_us / pictures.max(1) as f64;
    outcome
}

fn view(observer: &RobotState, robot: &RobotState, kind: Kind, presence: &crate::render::presence::Presence) -> View {
    let (dx, dy) = (robot.x_m - observer.x_m, robot.y_m - observer.y_m);
    let azimuth = dy.atan2(dx);
    View {
        robot: robot.id,
        kind,
        bearing_rad: turned(azimuth - observer.heading_rad),
        range_m: dx.hypot(dy),
        heading_rad: turned(robot.heading_rad - observer.heading_rad),
        turn_rad: turned(azimuth + 0.5 * TAU - robot.heading_rad).abs(),
        visible: presence.visible(),
        pixels: presence.alone,
        before: Before::Nothing,
    }
}

/// What stands before robot `n` as the first one sees it.
fn before(state: &State, n: usize, visible: f64) -> Before {
    let place = |r: &RobotState| Vector2::new(r.x_m, r.y_m);
    let eye = place(&state.robots[0]);
    let way = place(&state.robots[n]) - eye;
    let is_between = |p: Vector2<f64>| {
        let along = (p - eye).dot(&way) / way.norm_squared();
        (0.0..1.0).contains(&along) && (p - eye - along * way).norm() < BESIDE_M
    };
    let others = || state.robots.iter().enumerate().filter(|(k, _)| *k != 0 && *k != n).map(|(_, r)| place(r));
    if visible >= WHOLE {
        Before::Nothing
    } else if state.people.iter().any(|p| is_between(Vector2::new(p.x_m, p.y_m))) {
        Before::Person
    } else if others().any(is_between) {
        Before::Robot
    } else {
        Before::Thing
    }
}

/// The likeliest of what was fitted where a robot is.
fn likeliest(view: &View, fits: &[Fit]) -> Option<Traits> {
    let there = fits.iter().filter(|fit| view.may_be(&fit.peer)).map(|fit| &fit.traits);
    there.max_by(|a, b| a.log_odds().total_cmp(&b.log_odds())).cloned()
}

/// An angle in −π … π.
pub(super) fn turned(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// Each sighting belongs to the robot that it is nearest to on the floor, if it is near at all and nobody else has it.
fn matched(peers: Vec<Peer>, views: &[View]) -> Vec<Sighting> {
    let mut taken = vec![false; views.len()];
    peers
        .into_iter()
        .map(|peer| {
            let near = (0..views.len())
                .filter(|n| !taken[*n] && views[*n].may_be(&peer))
                .min_by(|a, b| views[*a].apart_m(&peer).total_cmp(&views[*b].apart_m(&peer)));
            if let Some(n) = near {
                taken[n] = true;
            }
            Sighting { peer, view: near }
        })
        .collect()
}
