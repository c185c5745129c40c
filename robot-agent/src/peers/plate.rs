//! A flat striped plate: its plane from the stripes, its sides from their edges, and from these where its robot is and looks.
//!
//! Problem: the ratio of the heights of a plate's two sides (the paper's way, report 5.2.3) tells its turn badly: 0.8 m at 3 m.
//! Insight: stripes at announced heights give the distance in every column, so the whole plate is a plane n·x = c measured
//! by all of its pixels, and the known width ties the two sides together. The back is painted in the negative, so the sign
//! of the stripes says which side one looks at. Algorithm: as for rings (`super::rings`), with every column's light
//! eliminated, on (direction of the normal, distance, height); then each side as an outline (`super::edges`); then the pose by
//! least squares from two bearings and the plane. A striped box can look much like that: whether width and height agree with
//! the announced ones (χ²), whether stripes go on above, below or beside (`ends`), and whether the upper end is where it should be, is
//! weighed together ([`credible`]).

pub(super) mod credible;
mod ends;
mod line;
mod plane;
mod rim;
mod search;

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use protocol::angle::{difference, wrap};
use protocol::marker::Marker;
use protocol::message::observation::FeaturePart;
use protocol::time::Timestamp;

use super::edges::{EdgeFit, Side};
use super::look::{CylinderLook, PlateLook};
use super::rays::{PixelRays, Sample};
use super::refusals::{How, Refusals};
use super::search::Grid;
use super::verdict::{Basis, Fit, Fits, LEAST_LOG_ODDS, Traits};
use super::{Find, Peer, PeerFeature};
use crate::optics::MountedCamera;
use ends::side_sigma;
use line::LineSearch;
use plane::{Plane, PlaneFit};
use rim::SideShown;
use search::{PlateCandidate, PlateSearch};

/// Turns of a known plate that the fit starts from, radians; of one that was searched for, beside the turn that was found.
const TURNS: [f64; 5] = [0.0, -0.5, 0.5, -0.95, 0.95];
const OTHER_TURNS: [f64; 4] = [0.0, -0.2, 0.2, 0.5];
/// Beyond this the search cannot tell the turn, metres: a turned plate is nowhere more than a row nearer.
const TURN_UNKNOWN_M: f64 = 2.2;
/// A fit this good needs no other start.
const SURE: f64 = 0.985;
/// Turned further than this from the observer nothing is said, radians.
const MOST_TURN_RAD: f64 = 1.2;
// Beyond these limits a fit is no plate; what remains is judged by all of its traits ([`credible`]).
/// χ² of width or height beyond which two sides are not both the plate's.
const WORST_CHI2: f64 = 25.0;
/// To this χ² a plate that seems too narrow may be whole and its plane too near, which is as uncertain then.
const PLANE_WRONG_CHI2: f64 = 80.0;
/// From this χ² on, something may stand before one of the sides of a plate that seems too narrow, of which this share must show.
const NARROW_CHI2: f64 = 9.0;
const LEAST_SHOWN: f64 = 0.5;
/// Columns tell to this where stripes end, pixels.
const RUN_END_PX: f64 = 2.0;
/// A side that something hides is where the width puts it, as surely as nothing, radians.
const UNSEEN_SIGMA_RAD: f64 = 1.0;
/// Another pair of sides whose χ² is larger by less is as good.
const AS_GOOD_CHI2: f64 = 6.0;
/// Poses nearer to each other than this, χ², are the same.
const SAME_CHI2: f64 = 0.5;
/// The heights of the stripes are right to this when noise has averaged out, metres.
const HEIGHT_FLOOR_M: f64 = 3e-3;
/// Beyond, a plate is too few pixels for its stripes to be told from a cylinder's rings, metres.
const FARTHEST_M: f64 = 6.2;
/// The plane's distance is right to this share when noise has averaged out; its turn to this angle.
const DISTANCE_FLOOR: f64 = 6e-3;
const TURN_FLOOR_RAD: f64 = 6e-3;
/// So far above the upper end is looked at: there is the mast of a robot, or more of what is taller, radians.
const ABOVE_END_RAD: f64 = 0.15;
const MAX_PEERS: usize = 8;
/// What may be a plate by this much is one unless likelier ones are as many as were announced. Of 1,472 fits to plates in rooms unseen 0.5
/// lets 1,364 through, with 13 to other things; 1.2 lets 1,341 through, with 9.
const POSSIBLE_LOG_ODDS: f64 = 0.3;

/// Finds plates of one look.
#[derive(Debug)]
pub struct PlateFinder {
    look: PlateLook,
    /// The plate's stripes as rings: what profiles are worked out of.
    pillar: CylinderLook,
    search: PlateSearch,
    /// By the upper end, and by the edge between the two upper stripes.
    end_search: LineSearch,
    edge_search: LineSearch,
    samples: Vec<Sample>,
    /// Of the sensor in the picture at hand, squared grey levels.
    noise2: f64,
    /// What was fitted, where that is asked for.
    fits: Fits,
    refusals: Refusals,
    looks: usize,
}

/// How the height of a plate's stripes is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Height {
    /// Two edges between stripes are in view.
    ByStripes,
    /// One is, and the upper end.
    ByEnd,
    /// One is, and it is where it is announced to be.
    Announced,
}

/// A plate's robot (x, y, heading) from its plane and the bearings of its sides.
struct Posed {
    /// Of the one number too many.
    chi2: f64,
    pose: Vector3<f64>,
    covariance: Matrix3<f64>,
    right: (f64, EdgeFit),
    left: (f64, EdgeFit),
    /// Another pair of sides is as good: the covariance covers both, the sides are nobody's.
    is_torn: bool,
    /// Front and back are told apart.
    has_heading: bool,
    /// Share of the width between the two sides that were measured.
    shown: f64,
}

impl Posed {
    /// Midway between two answers of which either may be right; the covariance covers both.
    fn or_as_likely(mut self, other: &Self) -> Self {
        let mut apart = other.pose - self.pose;
        apart[2] = difference(other.pose[2], self.pose[2]);
        self.pose += 0.5 * apart;
        self.covariance = 0.5 * (self.covariance + other.covariance) + 0.25 * apart * apart.transpose();
        self.chi2 = self.chi2.max(other.chi2);
        self.is_torn = true;
        self
    }

    /// Half hidden, or whole and at odds with its plane, which is as uncertain as that says.
    fn or_whole(self, whole: &Self) -> Self {
        let chi2 = self.chi2;
        let whole = Self { covariance: whole.covariance * whole.chi2.max(1.0), ..*whole };
        Self { chi2, ..self.or_as_likely(&whole) }
    }
}

impl PlateFinder {
    /// Prepares the search for one look.
    pub fn new(camera: &MountedCamera, grid: Grid, look: PlateLook) -> Self {
        let lowest = camera.camera().elevation_rad()[0].tan();
        let pillar = look.pillar();
        let search = PlateSearch::new(grid, &look, camera.viewpoint_body_m().z, lowest);
        let by_line = |line_m: f64| LineSearch::new(grid, &look, line_m, camera.viewpoint_body_m().z);
        let end_search = by_line(pillar.high_m());
        let edge_search = by_line(pillar.edges_m[pillar.edges_m.len() - 2]);
        let (samples, fits, refusals) = (Vec::new(), Fits::default(), Refusals::default());
        Self { look, pillar, search, end_search, edge_search, samples, noise2: 0.0, fits, refusals, looks: 0 }
    }

    /// Bytes of the panorama that the search expects.
    pub fn panorama_len(&self) -> usize {
        self.search.len()
    }

    /// What was fitted since the last call, robot or not; kept from the first call on.
    pub fn take_fits(&mut self) -> Vec<Fit> {
        self.fits.take()
    }

    /// Places that the last call looked at closely.
    pub fn looks(&self) -> usize {
        self.looks
    }

    /// The camera has moved.
    pub fn forget(&mut self) {
        self.refusals.forget();
    }

    /// The plates in a picture; `stream` is when one of a stream was taken.
    pub fn find(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        panorama: Option<&[u8]>,
        stream: Option<Timestamp>,
        known: &[(f64, f64)],
    ) -> Vec<Find> {
        self.noise2 = rays.noise2();
        self.looks = 0;
        // Of a known peer the axis is known, which the plate is not far from.
        let mut candidates: Vec<(PlateCandidate, &[f64], Option<How>)> = known
            .iter()
            .map(|(bearing_rad, range_m)| {
                let axis =
                    PlateCandidate { bearing_rad: *bearing_rad, distance_m: *range_m, turn_rad: 0.0, support: 1.0 };
                (axis, TURNS.as_slice(), None)
            })
            .collect();
        if let Some(panorama) = panorama {
            self.refusals.begin_search(stream);
            candidates.extend(self.search.run(panorama).into_iter().map(|c| match c.distance_m < TURN_UNKNOWN_M {
                true => (c, OTHER_TURNS.as_slice(), Some(How::Stripes)),
                false => (PlateCandidate { turn_rad: 0.0, ..c }, TURNS.as_slice(), Some(How::Stripes)),
            }));
        }
        let edges = panorama.map_or(Vec::new(), |panorama| self.edge_search.run(panorama));
        candidates.extend(edges.iter().map(|c| (*c, [0.0].as_slice(), Some(How::Edge))));
        let mut found: Vec<Find> = Vec::new();
        for (candidate, turns, how) in candidates {
            let place = how.map(|how| candidate.place(how));
            if self.is_found(&found, &candidate) || place.is_some_and(|place| self.refusals.hold(&place)) {
                continue;
            }
            self.looks += 1;
            let fit = self.look_closer(camera, rays, raw, &candidate, turns);
            if let Some(place) = place.filter(|_| fit.as_ref().is_none_or(|fit| fit.traits.are_hopeless())) {
                self.refusals.note(place);
            }
            self.take(&mut found, fit);
        }
        // Above the edge between two stripes is the upper end, which may be measured where that edge cannot.
        let ends = panorama.map_or(Vec::new(), |panorama| self.end_search.run(panorama));
        for candidate in ends.into_iter().chain(edges) {
            let place = candidate.place(How::PlateEnd);
            if self.is_found(&found, &candidate) || self.refusals.hold(&place) {
                continue;
            }
            self.looks += 1;
            let [by_stripes, by_end] = self.look_at_end(camera, rays, raw, &candidate);
            if by_stripes.iter().chain(&by_end).all(|fit| fit.traits.are_hopeless()) {
                self.refusals.note(place);
            }
            self.take(&mut found, by_stripes);
            self.take(&mut found, by_end);
        }
        found
    }

    /// Whether a candidate is a plate that was found already, beyond doubt.
    fn is_found(&self, found: &[Find], candidate: &PlateCandidate) -> bool {
        found.iter().filter(|find| find.log_odds >= LEAST_LOG_ODDS).map(|find| &find.peer).any(|p| {
            let apart = difference(p.bearing_rad, candidate.bearing_rad).abs() * p.range_m.min(candidate.distance_m);
            apart < 0.4 * self.look.width_m && (p.range_m / candidate.distance_m - 1.0).abs() < 0.25
        })
    }

    /// Keeps a fit that may be a robot, unless it is there already and likelier; what is there beyond doubt gives way to stripes alone,
    /// which measure better than an upper end, and to that where it shows both sides and the stripes did not.
    fn take(&mut self, found: &mut Vec<Find>, fit: Option<Fit>) {
        let Some(fit) = fit else { return };
        self.fits.keep(&fit);
        let is_by_stripes = fit.traits.basis == Basis::Stripes;
        let (log_odds, peer) = (fit.traits.log_odds(), fit.peer);
        let is_beside = |f: &Find| difference(f.peer.bearing_rad, peer.bearing_rad).abs() * peer.range_m < 0.2;
        let beside = found.iter().position(is_beside);
        let find = Find { log_odds, peer, half_m: 0.5 * self.look.width_m, high_m: self.pillar.high_m() };
        match beside {
            _ if log_odds < POSSIBLE_LOG_ODDS => {}
            None if found.len() < MAX_PEERS => found.push(find),
            Some(i) => {
                let before = &found[i];
                let is_better = is_by_stripes
                    || before.log_odds < LEAST_LOG_ODDS
                    || before.peer.features.is_empty() && !find.peer.features.is_empty();
                if is_better && log_odds > before.log_odds {
                    found[i] = find;
                }
            }
            None => {}
        }
    }

    /// A plate that was searched for by its upper end: by its stripes, and by that end.
    fn look_at_end(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidate: &PlateCandidate,
    ) -> [Option<Fit>; 2] {
        let (bearing, distance) = (candidate.bearing_rad, candidate.distance_m);
        let rise = self.pillar.high_m() - camera.viewpoint_body_m().z;
        let [lowest, highest] = camera.camera().elevation_rad();
        let nearest = (0.8 * distance - 0.5 * self.look.width_m).max(0.2);
        let ends = [rise.atan2(nearest), rise.atan2(1.2 * distance + 0.5 * self.look.width_m)];
        let high = (ends[0].max(ends[1]) + ABOVE_END_RAD).clamp(lowest, highest);
        let half = (0.5 * self.look.width_m / (distance - 0.4 * self.look.width_m).max(0.2)).atan();
        let mut samples = std::mem::take(&mut self.samples);
        rays.patch(camera, raw, bearing, half + 0.1, [lowest, high], &mut samples);
        let turn = candidate.turn_rad;
        let plane = Plane { alpha: bearing + turn, c: distance * turn.cos(), lower_m: 0.0 };
        let fit = self.fit_rim(&samples, plane, bearing, rise);
        let fits = fit.map_or([None, None], |fit| {
            // Stripes tell more, now that it is known where to begin.
            let few = self.few(&samples, bearing, distance);
            let by_stripes = self.fit(&few, fit.plane, bearing).and_then(|fit| self.by_stripes(camera, &samples, &fit));
            [by_stripes, self.by_upper_end(camera, &samples, fit, self.ends_of(candidate))]
        });
        self.samples = samples;
        fits
    }

    /// Bearings of the right and the left end of a plate that was searched for.
    fn ends_of(&self, candidate: &PlateCandidate) -> [f64; 2] {
        let across = search::across(candidate.distance_m, 0.5 * self.look.width_m, candidate.turn_rad);
        [-1.0, 1.0].map(|share| wrap(candidate.bearing_rad + across(share).0))
    }

    fn by_upper_end(
        &self,
        camera: &MountedCamera,
        samples: &[Sample],
        mut fit: PlaneFit,
        searched_rad: [f64; 2],
    ) -> Option<Fit> {
        let mounting = camera.mounting().sigma;
        let tilt = mounting.rotation_rpy_rad[0].max(mounting.rotation_rpy_rad[1]);
        let rise = (self.pillar.high_m() - camera.viewpoint_body_m().z).abs();
        let by_height =
            fit.plane.c * mounting.position_m.z.hypot(HEIGHT_FLOOR_M).hypot(tilt * fit.plane.c) / rise.max(0.01);
        let c_floor = (DISTANCE_FLOOR * fit.plane.c).hypot(by_height);
        let plane_covariance = fit.with_floors(TURN_FLOOR_RAD, c_floor);
        let middle = fit.middle_rad();
        if difference(fit.plane.alpha, middle).abs() > MOST_TURN_RAD || !Self::is_straight(&fit) {
            return None;
        }
        let side = self.side_shown(samples, &fit);
        let posed = match side {
            SideShown::By { sign, .. } => {
                fit.sign = sign;
                self.between_sides(samples, &fit, &plane_covariance, searched_rad)?
            }
            SideShown::Unseen => self.of_either_side(samples, &fit, &plane_covariance, searched_rad)?,
            SideShown::Neither => return None,
        };
        if posed.chi2.is_nan() || posed.chi2 > WORST_CHI2 {
            return None;
        }
        let traits = self.end_traits(samples, &fit, &posed, side);
        self.sighted(camera, &fit, &posed, (&plane_covariance, c_floor), traits)
    }

    fn look_closer(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        candidate: &PlateCandidate,
        turns: &[f64],
    ) -> Option<Fit> {
        let (bearing, distance) = (candidate.bearing_rad, candidate.distance_m);
        let height = camera.viewpoint_body_m().z;
        let [lowest, highest] = camera.camera().elevation_rad();
        let near = (distance - 0.6 * self.look.width_m).max(0.2);
        let end = |z: f64| {
            let (a, b) = ((z - height).atan2(near), (z - height).atan2(distance * 1.15 + 0.5 * self.look.width_m));
            [a.min(b), a.max(b)]
        };
        // As much again above and below as a further stripe would need.
        let edges = &self.pillar.edges_m;
        let [below, above] = [edges[1] - edges[0], edges[edges.len() - 1] - edges[edges.len() - 2]];
        let elevation = [
            end(self.pillar.low_m() - 2.0 * below)[0].clamp(lowest, highest),
            (end(self.pillar.high_m() + 2.0 * above)[1] + 0.01).clamp(lowest, highest),
        ];
        let half = (self.look.width_m / distance).atan();
        let mut samples = std::mem::take(&mut self.samples);
        rays.patch(camera, raw, bearing, half + 0.06, elevation, &mut samples);
        let few = self.few(&samples, bearing, distance);
        let score = |f: &PlaneFit| f.correlation * difference(f.seen_rad[1], f.seen_rad[0]).abs().sqrt();
        let mut best: Option<PlaneFit> = None;
        for turn in turns.iter().map(|turn| candidate.turn_rad + turn) {
            let plane = Plane { alpha: bearing + turn, c: distance * turn.cos(), lower_m: 0.0 };
            if let Some(fit) = self.fit(&few, plane, bearing)
                && best.as_ref().is_none_or(|b| score(&fit) > score(b))
            {
                let is_sure = fit.correlation > SURE && turns.len() < TURNS.len();
                best = Some(fit);
                if is_sure {
                    break;
                }
            }
        }
        let fit = best.and_then(|fit| self.by_stripes(camera, &samples, &fit));
        self.samples = samples;
        fit
    }

    fn by_stripes(&self, camera: &MountedCamera, samples: &[Sample], fit: &PlaneFit) -> Option<Fit> {
        let mounting = camera.mounting().sigma;
        let tilt = mounting.rotation_rpy_rad[0].max(mounting.rotation_rpy_rad[1]);
        let edges = self.edges_in_view(samples, fit);
        let height_m = camera.viewpoint_body_m().z;
        let height_sigma_m = mounting.position_m.z.hypot(tilt * fit.plane.c).hypot(HEIGHT_FLOOR_M);
        let chi2 = |fit: &PlaneFit| (fit.plane.lower_m / height_sigma_m).powi(2);
        let announced = |lone: f64| {
            let fit = Self::by_height(fit, lone, height_m, height_sigma_m)?;
            Some((fit, Height::Announced, 0.0))
        };
        let planes = match edges[..] {
            [] => return None,
            [lone] => {
                let by_end = self.with_end(samples, fit, lone, height_m).map(|end| {
                    let fit = Self::with_height(&end, height_sigma_m);
                    (fit, Height::ByEnd, chi2(&end))
                });
                by_end.into_iter().chain(announced(lone)).collect()
            }
            _ => vec![(fit.clone(), Height::ByStripes, chi2(fit))],
        };
        let mut best: Option<Fit> = None;
        // What ends near the upper end may be something behind a plate whose upper stripe is as dark or as bright.
        for (plane, height, height_chi2) in planes {
            if let Some(fit) = self.by_plane(camera, samples, (&plane, fit.seen_rad), (height, height_chi2), tilt)
                && best.as_ref().is_none_or(|best| fit.traits.log_odds() > best.traits.log_odds())
            {
                let is_taken = fit.is_taken;
                best = Some(fit);
                if is_taken {
                    break;
                }
            }
        }
        best
    }

    /// The plate in the plane of its stripes, which are seen between two bearings. Their height is known in some way, with its χ²; `tilt` is the
    /// camera's standard deviation.
    fn by_plane(
        &self,
        camera: &MountedCamera,
        samples: &[Sample],
        (fit, stripes_rad): (&PlaneFit, [f64; 2]),
        (height, height_chi2): (Height, f64),
        tilt: f64,
    ) -> Option<Fit> {
        let middle = fit.middle_rad();
        if difference(fit.plane.alpha, middle).abs() > MOST_TURN_RAD || !fit.is_flat() || height_chi2 > WORST_CHI2 {
            return None;
        }
        // A wrong height or tilt shifts the distance; both are in the fitted height as far as stripes can tell.
        let c_floor = DISTANCE_FLOOR * fit.plane.c + tilt * fit.plane.c;
        let plane_covariance = fit.with_floors(TURN_FLOOR_RAD, c_floor);
        let posed = self.between_sides(samples, fit, &plane_covariance, stripes_rad)?;
        if posed.chi2.is_nan() || posed.chi2 > WORST_CHI2 {
            return None;
        }
        let traits = self.stripe_traits(samples, fit, &posed, (height, height_chi2));
        self.sighted(camera, fit, &posed, (&plane_covariance, c_floor), traits)
    }

    fn sighted(
        &self,
        camera: &MountedCamera,
        fit: &PlaneFit,
        posed: &Posed,
        (plane_covariance, c_floor): (&Matrix2<f64>, f64),
        traits: Traits,
    ) -> Option<Fit> {
        let is_taken = traits.are_credible();
        Some(Fit { peer: self.peer(camera, fit, posed, plane_covariance, c_floor)?, traits, is_taken })
    }

    /// The robot of a plate.
    fn peer(
        &self,
        camera: &MountedCamera,
        fit: &PlaneFit,
        posed: &Posed,
        plane_covariance: &Matrix2<f64>,
        c_floor: f64,
    ) -> Option<Peer> {
        let look = &self.look;
        let is_front = fit.sign > 0.0;
        let Posed { chi2, pose, covariance, right, left, is_torn, has_heading, .. } = posed;
        let covariance = covariance * chi2.max(1.0);
        let range = pose[0].hypot(pose[1]);
        if range > FARTHEST_M {
            return None;
        }
        let bearing = pose[1].atan2(pose[0]);
        let (s, c) = bearing.sin_cos();
        let polar = SMatrix::<f64, 2, 3>::new(-s / range, c / range, 0.0, c, s, 0.0);
        let edge = |e: &(f64, EdgeFit), is_right: bool| {
            let index = u8::from(is_right != is_front);
            let distance = fit.plane.distance(e.0);
            let rise = [look.bottom_m, look.bottom_m + look.height_m].map(|z| z - camera.viewpoint_body_m().z);
            let grow = Vector2::new(-distance * (e.0 - fit.plane.alpha).tan(), distance / fit.plane.c);
            let distance_sigma = (grow.transpose() * plane_covariance * grow)[0].max(0.0).sqrt();
            let by_distance = rise.iter().map(|r| (r / (r * r + distance * distance)).abs()).fold(0.0, f64::max);
            let elevation_floor_rad = by_distance * c_floor;
            PeerFeature {
                part: FeaturePart::Edge(index),
                bearing_rad: e.0,
                sigma_rad: side_sigma(fit, e)[0],
                floor_rad: side_sigma(fit, e)[1],
                elevation_rad: Some(rise.map(|r| r.atan2(distance))),
                elevation_sigma_rad: by_distance * distance_sigma,
                elevation_floor_rad,
            }
        };
        Some(Peer {
            kind: Marker::RECTANGLE,
            robot: None,
            bearing_rad: bearing,
            range_m: range,
            covariance: polar * covariance * polar.transpose(),
            heading_rad: has_heading.then(|| [wrap(pose[2]), covariance[(2, 2)].sqrt()]),
            confidence: fit.correlation.clamp(0.0, 1.0),
            features: if *is_torn { Vec::new() } else { vec![edge(right, true), edge(left, false)] },
        })
    }

    /// The pose between two sides. Where the background goes on with a stripe, the run of columns ends too late: then one side is
    /// where the width puts it beside the other. Where it is as dark or as bright as the plate, the run ends too early: then a side is
    /// looked for elsewhere (`or_rad`: right, left).
    fn between_sides(
        &self,
        samples: &[Sample],
        fit: &PlaneFit,
        plane_covariance: &Matrix2<f64>,
        or_rad: [f64; 2],
    ) -> Option<Posed> {
        let [right, left] = [(Side::Right, 0), (Side::Left, 1)].map(|(side, k)| {
            let by_run = self.side(samples, fit, side, fit.seen_rad[k]);
            by_run.or_else(|| self.side(samples, fit, side, or_rad[k]))
        });
        let wide_m = self.look.width_m;
        let by_right = right.and_then(|r| self.side(samples, fit, Side::Left, fit.plane.beside(r.0, wide_m)));
        let by_left = left.and_then(|l| self.side(samples, fit, Side::Right, fit.plane.beside(l.0, -wide_m)));
        let mut posed: Vec<Posed> = [(right, left), (right, by_right), (by_left, left)]
            .into_iter()
            .filter_map(|(right, left)| self.pose(fit, plane_covariance, right?, left?))
            .collect();
        posed.sort_by(|a, b| a.chi2.total_cmp(&b.chi2));
        // Where one side is hidden by somebody without an upright edge of his own, the stripes end there.
        let run_end = |other: Option<(f64, EdgeFit)>, at: f64| {
            let (_, edge) = other?;
            let sigma_rad = RUN_END_PX / edge.px_per_rad;
            Some((at, EdgeFit { outwards_rad: 0.0, sigma_rad, agreement: 0.0, rows: 0, ..edge }))
        };
        let narrow = || {
            let [right_end, left_end] = [run_end(left, fit.seen_rad[0]), run_end(right, fit.seen_rad[1])];
            self.half_hidden(fit, plane_covariance, right.or(right_end)?, left.or(left_end)?)
        };
        if posed.first().is_none_or(|best| best.chi2 > NARROW_CHI2)
            && let Some(narrow) = narrow()
        {
            // A whole plate looks narrow, too, where its plane is a little too near.
            return Some(match posed.first().filter(|whole| whole.chi2 <= PLANE_WRONG_CHI2) {
                Some(whole) => narrow.or_whole(whole),
                None => narrow,
            });
        }
        let mut rest = posed.into_iter();
        let mut best = rest.next()?;
        // What the picture cannot tell apart the answer covers; mostly they are the same sides again.
        let own = best.covariance.try_inverse()?;
        for other in rest.filter(|other| other.chi2 < best.chi2 + AS_GOOD_CHI2) {
            let mut apart = other.pose - best.pose;
            apart[2] = difference(other.pose[2], best.pose[2]);
            if (apart.transpose() * own * apart)[0] > SAME_CHI2 {
                best.covariance += apart * apart.transpose();
                best.is_torn = true;
            }
        }
        Some(best)
    }

    /// The pose where something stands before one of the sides, of which nobody knows which: midway between what either would mean.
    fn half_hidden(
        &self,
        fit: &PlaneFit,
        plane_covariance: &Matrix2<f64>,
        right: (f64, EdgeFit),
        left: (f64, EdgeFit),
    ) -> Option<Posed> {
        let point = |at: f64| Vector2::new(at.cos(), at.sin()) * fit.plane.distance(at);
        let shown = (point(left.0) - point(right.0)).norm() / self.look.width_m;
        if !(LEAST_SHOWN..1.0).contains(&shown) {
            return None;
        }
        let unseen = |(at, edge): (f64, EdgeFit), sign: f64| {
            (fit.plane.beside(at, sign * self.look.width_m), EdgeFit { sigma_rad: UNSEEN_SIGMA_RAD, ..edge })
        };
        let by_right = self.pose(fit, plane_covariance, right, unseen(right, 1.0))?;
        let mut posed = by_right.or_as_likely(&self.pose(fit, plane_covariance, unseen(left, -1.0), left)?);
        (posed.right, posed.left, posed.shown) = (right, left, shown);
        Some(posed)
    }

    /// Pose by least squares from the plane and the sides.
    fn pose(
        &self,
        fit: &PlaneFit,
        plane_covariance: &Matrix2<f64>,
        right: (f64, EdgeFit),
        left: (f64, EdgeFit),
    ) -> Option<Posed> {
        let look = &self.look;
        let is_front = fit.sign > 0.0;
        // Front: the edge on the observer's right is the body's left one.
        let own_y = [look.width_m - look.left_edge_m, -look.left_edge_m];
        let [right_y, left_y] = if is_front { own_y } else { [own_y[1], own_y[0]] };
        let weight = plane_covariance.try_inverse()?;
        let heading = if is_front { fit.plane.alpha + std::f64::consts::PI } else { fit.plane.alpha };
        // Start: the axis behind the middle of the two sides.
        let p = |b: f64| Vector2::new(b.cos(), b.sin()) * fit.plane.distance(b);
        let point = 0.5 * (p(right.0) + p(left.0));
        let (s, c) = heading.sin_cos();
        let (ahead, aside) = (look.behind_m, 0.5 * (right_y + left_y));
        let mut pose = Vector3::new(point.x - c * ahead + s * aside, point.y - s * ahead - c * aside, heading);
        let residuals = |pose: &Vector3<f64>| {
            let (s, c) = pose[2].sin_cos();
            let point = |y: f64| Vector2::new(pose[0] + c * look.behind_m - s * y, pose[1] + s * look.behind_m + c * y);
            let (r, l) = (point(right_y), point(left_y));
            let alpha = if is_front { pose[2] - std::f64::consts::PI } else { pose[2] };
            let distance = alpha.cos() * r.x + alpha.sin() * r.y;
            SVector::<f64, 4>::from([
                difference(right.0, r.y.atan2(r.x)),
                difference(left.0, l.y.atan2(l.x)),
                difference(fit.plane.alpha, alpha),
                fit.plane.c - distance,
            ])
        };
        let mut weights = SMatrix::<f64, 4, 4>::zeros();
        weights[(0, 0)] = side_sigma(fit, &right)[0].powi(-2);
        weights[(1, 1)] = side_sigma(fit, &left)[0].powi(-2);
        weights.fixed_view_mut::<2, 2>(2, 2).copy_from(&weight);
        let mut solved = None;
        for _ in 0..8 {
            let here = residuals(&pose);
            let mut j = SMatrix::<f64, 4, 3>::zeros();
            for k in 0..3 {
                let mut moved = pose;
                moved[k] += 1e-6;
                j.set_column(k, &((here - residuals(&moved)) / 1e-6));
            }
            let covariance = (j.transpose() * weights * j).try_inverse()?;
            pose += covariance * j.transpose() * weights * here;
            let here = residuals(&pose);
            solved = Some(((here.transpose() * weights * here)[0], covariance));
        }
        let (chi2, covariance) = solved?;
        Some(Posed { chi2, pose, covariance, right, left, is_torn: false, has_heading: true, shown: 1.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At a distance ahead that is right to a centimetre.
    fn posed(ahead_m: f64, chi2: f64) -> Posed {
        let side = (0.0, EdgeFit { outwards_rad: 0.0, sigma_rad: 1e-3, agreement: 1.0, rows: 20, px_per_rad: 170.0 });
        Posed {
            chi2,
            pose: Vector3::new(ahead_m, 0.0, 0.0),
            covariance: Matrix3::identity() * 1e-4,
            right: side,
            left: side,
            is_torn: false,
            has_heading: true,
            shown: 0.9,
        }
    }

    #[test]
    fn a_plate_half_hidden_or_whole_with_a_wrong_plane_is_within_its_sigmas_either_way() {
        let both = posed(1.05, 0.5).or_whole(&posed(1.12, 16.0));
        for truth_m in [1.05, 1.12] {
            assert!((both.pose[0] - truth_m).abs() < 1.5 * both.covariance[(0, 0)].sqrt(), "{}", both.pose[0]);
        }
        assert!(both.is_torn && (both.chi2 - 0.5).abs() < 1e-12);
    }
}
