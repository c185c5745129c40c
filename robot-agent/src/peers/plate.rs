//! A flat striped plate: its plane from the stripes, its sides from their edges, and from these where its robot is and looks.
//!
//! Problem: the ratio of the heights of a plate's two sides (the paper's way, report 5.2.3) tells its turn badly: 0.8 m at 3 m.
//! Insight: stripes at announced heights give the distance in every column, so the whole plate is a plane n·x = c measured
//! by all of its pixels, and the known width ties the two sides together. The back is painted in the negative, so the sign
//! of the stripes says which side one looks at. Algorithm: as for rings (`super::rings`), with every column's light
//! eliminated, on (direction of the normal, distance, height); then each side as an outline (`super::edges`); then the pose by
//! least squares from two bearings and the plane, which must agree (χ² of the one number too many).

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use protocol::angle::{difference, wrap};
use protocol::message::observation::FeaturePart;

use super::edges::{self, EdgeFit, Pixel, Side};
use super::look::{CylinderLook, MAX_RINGS, PlateLook};
use super::rays::{PixelRay, PixelRays, Sample};
use super::rings::{self, BLUR_PX, median};
use super::search::{Candidate, Grid, Search};
use super::{Find, Peer, PeerFeature};
use crate::optics::MountedCamera;

/// Turns of the plate that the fit starts from, radians.
const TURNS: [f64; 5] = [0.0, -0.5, 0.5, -0.95, 0.95];
/// A column shows the stripes at this correlation.
const LEAST_CORRELATION: f64 = 0.85;
/// Mean correlation of a plate's columns.
const LEAST_MEAN: f64 = 0.975;
const ROUNDS: usize = 8;
/// Turned further than this from the observer nothing is said, radians.
const MOST_TURN_RAD: f64 = 1.2;
/// Height of the camera over the peer's floor: mounting, tilt and floor together, metres.
const HEIGHT_SIGMA_M: f64 = 0.02;
/// The announced heights must fit to this, metres, beside what the mounting leaves open: striped boxes are many.
const HEIGHT_GATE_M: f64 = 0.015;
/// χ² of one number that one plate in 100 exceeds: its width is what tells it from a striped box.
const WORST_CHI2: f64 = 6.63;
/// Beyond, a plate is too few pixels for its stripes to be told from a cylinder's rings, metres.
const FARTHEST_M: f64 = 5.0;
/// Stripe edges that must be in view: a lone edge may be any of them, or the plate's end, in either sign.
const LEAST_EDGES: usize = 2;
/// The plane's distance is right to this share when noise has averaged out; its turn to this angle.
const PLANE_FLOOR: [f64; 2] = [6e-3, 1.5e-3];
const EDGE_FLOOR_PX: f64 = 0.06;
/// A sheet has a rim of its own, metres.
const RIM_FLOOR_M: f64 = 2e-3;
/// Columns of one picture's width looked at on either side of where the plate may end.
const BESIDE_PX: f64 = 9.0;
/// Most pixels of a fit: a plate near at hand has more than it needs.
const MOST_PIXELS: usize = 1500;
/// A first round whose stripes correlate less is not worth a second.
const HOPELESS: f64 = 0.75;
const LEAST_COLUMNS: usize = 4;
const MAX_PEERS: usize = 8;

/// Finds plates of one look.
#[derive(Debug)]
pub struct PlateFinder {
    look: PlateLook,
    /// The search takes a slim pillar with the plate's stripes.
    pillar: CylinderLook,
    search: Search,
    samples: Vec<Sample>,
}

/// A vertical plane cosα·x + sinα·y = c, the observer at its near side.
#[derive(Debug, Clone, Copy)]
struct Plane {
    alpha: f64,
    c: f64,
    lower_m: f64,
}

impl Plane {
    /// Along the floor from a ray's origin, and the height there.
    fn meet(&self, ray: &PixelRay) -> (f64, f64) {
        let (s, c) = self.alpha.sin_cos();
        let along = c * f64::from(ray.cosine) + s * f64::from(ray.sine);
        let from = self.c - c * f64::from(ray.origin_m[0]) - s * f64::from(ray.origin_m[1]);
        let distance = from / along.max(0.05);
        (distance, f64::from(ray.origin_m[2]) + f64::from(ray.slope) * distance)
    }

    /// Distance along a bearing from the axis.
    fn distance(&self, bearing: f64) -> f64 {
        self.c / (bearing - self.alpha).cos().max(0.05)
    }
}

struct PlaneFit {
    plane: Plane,
    /// Of (α, c), metres and radians.
    covariance: Matrix2<f64>,
    noise: f64,
    /// −1 where it is the back.
    sign: f64,
    /// Bearings between which columns show the stripes: right, left.
    seen_rad: [f64; 2],
    correlation: f64,
    gain: f64,
}

const N: usize = 6;
type Sums = SMatrix<f64, N, N>;

impl PlateFinder {
    /// Prepares the search for one look.
    pub fn new(camera: &MountedCamera, grid: Grid, look: PlateLook) -> Self {
        let lowest = camera.camera().elevation_rad()[0].tan();
        let pillar = look.pillar();
        let search = Search::new(grid, &pillar, camera.viewpoint_body_m().z, lowest);
        Self { look, pillar, search, samples: Vec::new() }
    }

    /// Bytes of the panorama that the search expects.
    pub fn panorama_len(&self) -> usize {
        self.search.len()
    }

    /// The plates in a picture.
    pub fn find(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        panorama: Option<&[u8]>,
        known: &[(f64, f64)],
    ) -> Vec<Find> {
        let mut candidates: Vec<(f64, f64)> = known.to_vec();
        if let Some(panorama) = panorama {
            let place = |c: &Candidate| (c.bearing_rad, c.range_m);
            candidates.extend(self.search.run(panorama).iter().map(place));
        }
        let mut peers: Vec<Peer> = Vec::new();
        for candidate in candidates {
            let apart = |p: &Peer| difference(p.bearing_rad, candidate.0).abs() * p.range_m.min(candidate.1);
            if peers.iter().any(|p| apart(p) < 0.4 * self.look.width_m && (p.range_m / candidate.1 - 1.0).abs() < 0.25)
            {
                continue;
            }
            if let Some(peer) = self.look_closer(camera, rays, raw, candidate)
                && !peers.iter().any(|p| difference(p.bearing_rad, peer.bearing_rad).abs() * peer.range_m < 0.2)
                && peers.len() < MAX_PEERS
            {
                peers.push(peer);
            }
        }
        let half_m = 0.5 * self.look.width_m;
        peers.into_iter().map(|peer| Find { misfit: 1.0 - peer.confidence, peer, half_m }).collect()
    }

    fn look_closer(
        &mut self,
        camera: &MountedCamera,
        rays: &mut PixelRays,
        raw: &[u8],
        (bearing, range): (f64, f64),
    ) -> Option<Peer> {
        let height = camera.viewpoint_body_m().z;
        let [lowest, highest] = camera.camera().elevation_rad();
        let near = (range - self.look.width_m).max(0.3);
        let end = |z: f64| {
            let (a, b) = ((z - height).atan2(near), (z - height).atan2(range * 1.15));
            [a.min(b), a.max(b)]
        };
        let elevation = [
            end(self.pillar.low_m())[0].clamp(lowest, highest),
            (end(self.pillar.high_m())[1] + 0.01).clamp(lowest, highest),
        ];
        let half = (self.look.width_m / range).min(1.0).asin();
        let mut samples = std::mem::take(&mut self.samples);
        rays.patch(camera, raw, bearing, half + 0.06, elevation, &mut samples);
        // The search's pillar is met a little before its axis.
        let distance = range - 0.9 * self.pillar.radius_m;
        let few = self.few(&samples, bearing, distance);
        let best = TURNS
            .iter()
            .filter_map(|turn| {
                let plane = Plane { alpha: bearing + turn, c: distance * turn.cos(), lower_m: 0.0 };
                self.fit(&few, plane, bearing)
            })
            .max_by(|a, b| {
                let score = |f: &PlaneFit| f.correlation * difference(f.seen_rad[1], f.seen_rad[0]).abs().sqrt();
                score(a).total_cmp(&score(b))
            });
        let peer = best.and_then(|fit| self.verdict(camera, &samples, &fit));
        self.samples = samples;
        peer
    }

    /// The pixels that may show a plate near a bearing at about a distance.
    fn few(&self, samples: &[Sample], bearing: f64, distance: f64) -> Vec<Sample> {
        let reach = (self.look.width_m / distance).min(1.0) + 0.05;
        let is_about = |s: &&Sample| {
            let height = f64::from(s.ray.origin_m[2]) + f64::from(s.ray.slope) * distance;
            let spread = 0.4 * f64::from(s.ray.slope).abs() * distance;
            difference(f64::from(s.ray.bearing_rad), bearing).abs() < reach
                && height + spread > self.pillar.low_m()
                && height - spread < self.pillar.high_m()
        };
        let about: Vec<Sample> = samples.iter().filter(is_about).copied().collect();
        let every = about.len().div_ceil(MOST_PIXELS).max(1);
        about.into_iter().step_by(every).collect()
    }

    /// The plane of the stripes near a bearing.
    fn fit(&self, samples: &[Sample], start: Plane, bearing: f64) -> Option<PlaneFit> {
        let mut plane = start;
        let scale = samples.first().map(|s| f64::from(s.ray.px_per_bearing))?;
        let reach = (self.look.width_m / plane.distance(bearing)).min(1.0) + 0.05;
        let wide = (1.0 / scale).max(reach / 60.0);
        let count = (2.0 * reach / wide).ceil() as usize;
        let mut fitted = None;
        for round in 0..ROUNDS {
            let blur_px = if round < 2 { BLUR_PX.hypot(1.4) } else { BLUR_PX };
            let grams = self.sums(samples, &plane, bearing, reach, wide, count, blur_px);
            let shown = shown(&grams, if round < 2 { 0.25 } else { 0.0 });
            let (first, last, sign) = run(&shown, bearing_column(reach, wide))?;
            let (mut h, mut g) = (Matrix3::<f64>::zeros(), Vector3::zeros());
            let (mut rest2, mut dof, mut correlation, mut used) = (0.0, 0.0, 0.0, 0);
            let mut gains = Vec::new();
            for (gram, column) in grams[first..=last].iter().zip(&shown[first..=last]) {
                let Some((own, gain)) = column.filter(|(c, _)| c * sign > 0.0) else { continue };
                let n = gram[(0, 0)];
                let pp = gram[(1, 1)] - gram[(0, 1)].powi(2) / n;
                let free = |i: usize, j: usize| {
                    let pi = gram[(1, i)] - gram[(0, 1)] * gram[(0, i)] / n;
                    let pj = gram[(1, j)] - gram[(0, 1)] * gram[(0, j)] / n;
                    gram[(i, j)] - gram[(0, i)] * gram[(0, j)] / n - pi * pj / pp
                };
                for i in 0..3 {
                    for j in 0..3 {
                        h[(i, j)] += gain * gain * free(2 + i, 2 + j);
                    }
                    g[i] += gain * free(2 + i, 5);
                }
                rest2 += free(5, 5).max(0.0);
                dof += n - 2.0;
                correlation += own.abs();
                used += 1;
                gains.push(gain.abs());
            }
            if used < LEAST_COLUMNS || dof < 8.0 || correlation < HOPELESS * used as f64 {
                return None;
            }
            let noise2 = (rest2 / dof).max(0.25);
            let priors = [(0, 0.0, 0.6), (1, 0.0, 0.3 * plane.c), (2, -plane.lower_m, HEIGHT_SIGMA_M)];
            for (k, value, sigma) in priors {
                h[(k, k)] += noise2 / (sigma * sigma);
                g[k] += noise2 * value / (sigma * sigma);
            }
            let inverse = h.try_inverse()?;
            let delta = inverse * g;
            plane.alpha += delta[0].clamp(-0.25, 0.25);
            plane.c += delta[1].clamp(-0.08 * plane.c, 0.08 * plane.c);
            plane.lower_m += delta[2].clamp(-0.02, 0.02);
            let drift = plane.distance(bearing) / start.distance(bearing);
            let turn = difference(plane.alpha, bearing).abs();
            if !(plane.c > 0.15 && (0.7..1.4).contains(&drift) && turn < MOST_TURN_RAD + 0.1) {
                return None;
            }
            let at = |column: usize| wrap(bearing - reach + (column as f64 + 0.5) * wide);
            fitted = Some(PlaneFit {
                plane,
                covariance: inverse.fixed_view::<2, 2>(0, 0) * noise2,
                noise: noise2.sqrt(),
                sign,
                seen_rad: [at(first), at(last)],
                correlation: correlation / used as f64,
                gain: median(&mut gains),
            });
        }
        fitted.filter(|f| f.correlation > LEAST_MEAN && f.gain > 6.0 * f.noise)
    }

    /// Sums over (1, profile, d/dα, d/dc, d/dlower, gray) by column.
    #[allow(clippy::too_many_arguments)]
    fn sums(
        &self,
        samples: &[Sample],
        plane: &Plane,
        bearing: f64,
        reach: f64,
        wide: f64,
        count: usize,
        blur_px: f64,
    ) -> Vec<Sums> {
        let look = &self.pillar;
        let mut grams = vec![Sums::zeros(); count];
        let mut by_ring = [0.0; MAX_RINGS];
        let turned = Plane { alpha: plane.alpha + 1e-4, ..*plane };
        let farther = Plane { c: plane.c * 1.0001, ..*plane };
        for sample in samples {
            let aside = difference(f64::from(sample.ray.bearing_rad), bearing);
            if aside.abs() >= reach {
                continue;
            }
            let (distance, height) = plane.meet(&sample.ray);
            let m_per_px = sample.ray.m_per_px(distance);
            let height_m = height + plane.lower_m;
            let margin = 2.4 * BLUR_PX * m_per_px;
            if height_m < look.low_m() + margin || height_m > look.high_m() - margin {
                continue;
            }
            let blur_m = blur_px * m_per_px;
            let mut value = |z: f64| rings::profile(look, &look.reflectance, z, blur_m, &mut by_ring);
            let here = value(height_m);
            let up = 0.05 * m_per_px;
            let by_height = (value(height_m + up) - value(height_m - up)) / (2.0 * up);
            let row = SVector::<f64, N>::from([
                1.0,
                here,
                by_height * (turned.meet(&sample.ray).1 - height) / 1e-4,
                by_height * (farther.meet(&sample.ray).1 - height) / (plane.c * 1e-4),
                by_height,
                sample.gray,
            ]);
            grams[(((aside + reach) / wide) as usize).min(count - 1)] += row * row.transpose();
        }
        grams
    }

    fn verdict(&self, camera: &MountedCamera, samples: &[Sample], fit: &PlaneFit) -> Option<Peer> {
        let look = &self.look;
        let middle = wrap(fit.seen_rad[0] + 0.5 * difference(fit.seen_rad[1], fit.seen_rad[0]));
        let mounting = camera.mounting().sigma;
        let tilt = mounting.rotation_rpy_rad[0].max(mounting.rotation_rpy_rad[1]);
        let height_gate_m = HEIGHT_GATE_M + 3.0 * mounting.position_m.z.hypot(tilt * fit.plane.c);
        if difference(fit.plane.alpha, middle).abs() > MOST_TURN_RAD
            || fit.plane.lower_m.abs() > height_gate_m
            || self.edges_in_view(samples, fit, middle) < LEAST_EDGES
        {
            return None;
        }
        let right = self.side(samples, fit, Side::Right)?;
        let left = self.side(samples, fit, Side::Left)?;
        let floor = |e: &(f64, EdgeFit)| (EDGE_FLOOR_PX / e.1.px_per_rad).hypot(RIM_FLOOR_M / fit.plane.distance(e.0));
        let sigma = |e: &(f64, EdgeFit)| e.1.sigma_rad.hypot(floor(e));
        let is_front = fit.sign > 0.0;
        // Front: the edge on the observer's right is the body's left one.
        let own_y = [look.width_m - look.left_edge_m, -look.left_edge_m];
        let [right_y, left_y] = if is_front { own_y } else { [own_y[1], own_y[0]] };
        // A wrong height or tilt shifts the distance; both are in the fitted height as far as stripes can tell.
        let c_floor = PLANE_FLOOR[0] * fit.plane.c + tilt * fit.plane.c;
        let plane_covariance =
            fit.covariance + Matrix2::new(PLANE_FLOOR[1].powi(2) * 16.0, 0.0, 0.0, c_floor * c_floor);
        let weight = plane_covariance.try_inverse()?;
        let heading_of = |alpha: f64| if is_front { alpha + std::f64::consts::PI } else { alpha };
        // Start: the axis behind the middle of the two sides.
        let mut pose = {
            let heading = heading_of(fit.plane.alpha);
            let p = |b: f64| Vector2::new(b.cos(), b.sin()) * fit.plane.distance(b);
            let centre = 0.5 * (p(right.0) + p(left.0));
            let own = Vector2::new(look.behind_m, 0.5 * (right_y + left_y));
            let (s, c) = heading.sin_cos();
            Vector3::new(centre.x - c * own.x + s * own.y, centre.y - s * own.x - c * own.y, heading)
        };
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
        weights[(0, 0)] = sigma(&right).powi(-2);
        weights[(1, 1)] = sigma(&left).powi(-2);
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
        if chi2.is_nan() || chi2 > WORST_CHI2 {
            return None;
        }
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
                sigma_rad: sigma(e),
                floor_rad: floor(e),
                elevation_rad: Some(rise.map(|r| r.atan2(distance))),
                elevation_sigma_rad: by_distance * distance_sigma,
                elevation_floor_rad,
            }
        };
        Some(Peer {
            kind: 2,
            robot: None,
            bearing_rad: bearing,
            range_m: range,
            covariance: polar * covariance * polar.transpose(),
            heading_rad: Some([wrap(pose[2]), covariance[(2, 2)].sqrt()]),
            confidence: fit.correlation.clamp(0.0, 1.0),
            features: vec![edge(&right, true), edge(&left, false)],
        })
    }

    /// Edges between two stripes that the picture reaches on both sides in the plate's middle.
    fn edges_in_view(&self, samples: &[Sample], fit: &PlaneFit, middle: f64) -> usize {
        let heights = samples
            .iter()
            .filter(|s| difference(f64::from(s.ray.bearing_rad), middle).abs() * f64::from(s.ray.px_per_bearing) < 3.0)
            .map(|s| fit.plane.meet(&s.ray).1 + fit.plane.lower_m);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        let inner = &self.pillar.edges_m[1..self.pillar.edges_m.len() - 1];
        inner.iter().filter(|edge| **edge > low + 0.02 && **edge < high - 0.02).count()
    }

    /// Bearing of one side of the plate.
    fn side(&self, samples: &[Sample], fit: &PlaneFit, side: Side) -> Option<(f64, EdgeFit)> {
        let look = &self.pillar;
        let (at, sign) = match side {
            Side::Right => (fit.seen_rad[0], -1.0),
            Side::Left => (fit.seen_rad[1], 1.0),
        };
        let mut by_ring = [0.0; MAX_RINGS];
        let mut pixels = Vec::new();
        let mut places = Vec::new();
        for sample in samples {
            let px_per_rad = f64::from(sample.ray.px_per_bearing);
            let inside_rad = -sign * difference(f64::from(sample.ray.bearing_rad), at);
            if (inside_rad * px_per_rad).abs() > BESIDE_PX {
                continue;
            }
            let (distance, height) = fit.plane.meet(&sample.ray);
            let blur_m = BLUR_PX * sample.ray.m_per_px(distance);
            let height = height + fit.plane.lower_m;
            if height < look.low_m() + 2.0 * blur_m || height > look.high_m() - 2.0 * blur_m {
                continue;
            }
            let middle = look.middle_reflectance();
            let ring = rings::profile(look, &look.reflectance, height, blur_m, &mut by_ring);
            pixels.push(Pixel {
                gray: sample.gray,
                row: 0,
                inside_rad,
                px_per_rad,
                half_px: BESIDE_PX,
                ring: middle + fit.sign * (ring - middle),
            });
            places.push(sample.ray.elevation_px());
        }
        let edge = edges::fit_rows(pixels, &places, (fit.noise, BLUR_PX), &[-3.0, -1.5, 0.0, 1.5, 3.0])?;
        let fine = edge.rows >= 2 && edge.agreement >= 0.5 && edge.sigma_rad * edge.px_per_rad < 0.5;
        fine.then(|| (wrap(at + sign * edge.outwards_rad), edge))
    }
}

fn bearing_column(reach: f64, wide: f64) -> usize {
    (reach / wide) as usize
}

/// Correlation and gain of each column that shows stripes or their negative.
fn shown(grams: &[Sums], slack: f64) -> Vec<Option<(f64, f64)>> {
    grams
        .iter()
        .map(|gram| {
            let n = gram[(0, 0)];
            let pp = gram[(1, 1)] - gram[(0, 1)].powi(2) / n;
            if n < 4.0 || pp < 2e-3 * n {
                return None;
            }
            let pi = gram[(1, 5)] - gram[(0, 1)] * gram[(0, 5)] / n;
            let ii = gram[(5, 5)] - gram[(0, 5)].powi(2) / n;
            let correlation = pi / (pp * (ii + 0.25 * n)).sqrt();
            (correlation.abs() > LEAST_CORRELATION - slack).then_some((correlation, pi / pp))
        })
        .collect()
}

/// The longest run of columns of one sign through or near the middle; gaps (a mast) up to a third of it are jumped.
fn run(shown: &[Option<(f64, f64)>], middle: usize) -> Option<(usize, usize, f64)> {
    let mut best: Option<(usize, usize, f64, usize)> = None;
    for sign in [1.0, -1.0] {
        let mut start: Option<(usize, usize, usize)> = None;
        let mut close = |run: Option<(usize, usize, usize)>| {
            if let Some((first, last, count)) = run
                && count >= LEAST_COLUMNS
                && best.is_none_or(|b| count > b.3)
            {
                best = Some((first, last, sign, count));
            }
        };
        for (i, column) in shown.iter().enumerate() {
            let shows = column.is_some_and(|(c, _)| c * sign > 0.0);
            match (&mut start, shows) {
                (Some((_, last, count)), true) => {
                    *last = i;
                    *count += 1;
                }
                (None, true) => start = Some((i, i, 1)),
                (Some((_, last, count)), false) if i - *last > (*count / 3).max(2) => {
                    close(start);
                    start = None;
                }
                _ => {}
            }
        }
        close(start);
    }
    let (first, last, sign, _) = best?;
    let slack = (last - first) / 2 + 2;
    (first <= middle + slack && last + slack >= middle).then_some((first, last, sign))
}
