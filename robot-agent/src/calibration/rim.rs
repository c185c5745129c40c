//! The circles that bound the picture of a mirror or an annular lens: their common centre is the optical centre, whatever
//! the camera's tilt.
//!
//! Along rays from the middle of the picture the edges across the ray are candidates. Circles through three candidates
//! about a third of a turn apart are tried in a fixed order; the one that most directions agree with is a rim, fitted to all
//! that agree with it (least squares with Tukey's weights). The next rim is sought among what is left.
//!
//! Source: `MATHS.md` §4.1.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::gradient::Gradients;
use crate::capture::GrayPicture;

/// Directions.
const RAYS: usize = 360;
/// Edges kept along a ray, strongest first.
const EDGES_A_RAY: usize = 8;
/// Gray levels per px below which there is no edge.
const MIN_STRENGTH: f32 = 4.0;
/// Share of the directions that must agree.
const MIN_COVERAGE: f64 = 0.5;
/// Directions agree within this distance, px.
const AGREEMENT_PX: f64 = 1.5;
/// The centre is within this share of the shorter side from the middle.
const MAX_OFFSET: f64 = 0.15;
/// Smallest radius, as a share of the shorter side.
const MIN_RADIUS: f64 = 0.05;
const TUKEY: f64 = 4.685;

/// A circle in the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Rim {
    /// Centre, px.
    pub centre_px: Vector2<f64>,
    /// Its covariance, px².
    pub covariance_px2: Matrix2<f64>,
    /// Radius, px.
    pub radius_px: f64,
    /// Share of the directions in which it was seen.
    pub coverage: f64,
    /// Rms distance of its edge points from the circle, px.
    pub rms_px: f64,
}

/// The common centre of several rims, weighted by their covariances; `None` without any. Its covariance is scaled up where
/// they contradict each other.
pub fn common_centre(rims: &[Rim]) -> Option<CommonCentre> {
    let mut information = Matrix2::zeros();
    let mut sum = Vector2::zeros();
    for rim in rims {
        let own = rim.covariance_px2.try_inverse()?;
        information += own;
        sum += own * rim.centre_px;
    }
    let covariance = information.try_inverse()?;
    let centre_px = covariance * sum;
    let chi2: f64 = rims
        .iter()
        .filter_map(|rim| {
            let off = rim.centre_px - centre_px;
            Some(off.dot(&(rim.covariance_px2.try_inverse()? * off)))
        })
        .sum();
    let dof = 2.0 * (rims.len() as f64 - 1.0);
    let scale = if dof > 0.0 { (chi2 / dof).max(1.0) } else { 1.0 };
    Some(CommonCentre { centre_px, covariance_px2: covariance * scale })
}

/// Where several rims have their centre.
#[derive(Debug, Clone, PartialEq)]
pub struct CommonCentre {
    /// px.
    pub centre_px: Vector2<f64>,
    /// px².
    pub covariance_px2: Matrix2<f64>,
}

struct Edge {
    ray: usize,
    at: Vector2<f64>,
}

/// The rims of a picture, at most `count`, the most complete first.
pub fn find(picture: &GrayPicture, count: usize) -> Vec<Rim> {
    let gradients = Gradients::new(picture);
    let side = picture.width.min(picture.height);
    let middle = Vector2::new(0.5 * (f64::from(picture.width) - 1.0), 0.5 * (f64::from(picture.height) - 1.0));
    let mut edges = edges(&gradients, &middle, f64::from(side));
    let mut rims = Vec::new();
    while rims.len() < count {
        let Some(rim) = most_complete(&edges, &middle, f64::from(side)).and_then(|(c, r)| fitted(&edges, c, r)) else {
            break;
        };
        edges.retain(|e| ((e.at - rim.centre_px).norm() - rim.radius_px).abs() > 3.0 * AGREEMENT_PX);
        rims.push(rim);
    }
    rims
}

fn edges(gradients: &Gradients, middle: &Vector2<f64>, side: f64) -> Vec<Edge> {
    let mut all = Vec::new();
    for ray in 0..RAYS {
        let angle = std::f64::consts::TAU * ray as f64 / RAYS as f64;
        let out = Vector2::new(angle.cos(), angle.sin());
        let strength =
            |r: f64| gradients.between(&(middle + out * r)).map_or(0.0, |g| g.map(f64::from).dot(&out) as f32);
        let mut found: Vec<(f32, f64)> = Vec::new();
        let mut r = MIN_RADIUS * side;
        while r < 0.75 * side {
            let (before, here, after) = (strength(r - 1.0).abs(), strength(r).abs(), strength(r + 1.0).abs());
            if here > MIN_STRENGTH && here >= before && here > after {
                let bend = before - 2.0 * here + after;
                let offset = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
                found.push((here, r + f64::from(offset)));
            }
            r += 1.0;
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.truncate(EDGES_A_RAY);
        all.extend(found.into_iter().map(|(_, r)| Edge { ray, at: middle + out * r }));
    }
    all
}

/// The circle that most directions agree with.
fn most_complete(edges: &[Edge], middle: &Vector2<f64>, side: f64) -> Option<(Vector2<f64>, f64)> {
    const TRIPLES: usize = 24;
    let of_ray = |ray: usize| edges.iter().filter(move |e| e.ray == ray % RAYS).map(|e| e.at);
    let mut best: Option<(usize, Vector2<f64>, f64)> = None;
    for k in 0..TRIPLES {
        let first = k * RAYS / (3 * TRIPLES);
        for a in of_ray(first) {
            for b in of_ray(first + RAYS / 3) {
                for c in of_ray(first + 2 * RAYS / 3) {
                    let Some((centre, radius)) = circle_through(&a, &b, &c) else { continue };
                    if (centre - middle).norm() > MAX_OFFSET * side || radius < MIN_RADIUS * side {
                        continue;
                    }
                    let agreeing = agreement(edges, &centre, radius);
                    if best.as_ref().is_none_or(|(most, ..)| agreeing > *most) {
                        best = Some((agreeing, centre, radius));
                    }
                }
            }
        }
    }
    let (agreeing, centre, radius) = best?;
    (agreeing as f64 >= MIN_COVERAGE * RAYS as f64).then_some((centre, radius))
}

/// Directions with an edge on the circle.
fn agreement(edges: &[Edge], centre: &Vector2<f64>, radius: f64) -> usize {
    let (mut count, mut last) = (0, usize::MAX);
    for edge in edges {
        if edge.ray != last && ((edge.at - centre).norm() - radius).abs() < AGREEMENT_PX {
            count += 1;
            last = edge.ray;
        }
    }
    count
}

fn circle_through(a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
    let rows = Matrix2::new(b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let right = Vector2::new(b.norm_squared() - a.norm_squared(), c.norm_squared() - a.norm_squared()) * 0.5;
    let centre = rows.try_inverse()? * right;
    Some((centre, (a - centre).norm()))
}

/// Gauss–Newton on the distances to the circle.
fn fitted(edges: &[Edge], mut centre: Vector2<f64>, mut radius: f64) -> Option<Rim> {
    let mut sigma = AGREEMENT_PX;
    let mut result = None;
    for _ in 0..30 {
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        let (mut squares, mut weights) = (0.0, 0.0);
        let mut distances = Vec::new();
        for edge in edges {
            let out = edge.at - centre;
            let error = out.norm() - radius;
            let t = error / (TUKEY * sigma);
            if t.abs() >= 1.0 {
                continue;
            }
            let weight = (1.0 - t * t).powi(2);
            let row = Vector3::new(out.x / out.norm(), out.y / out.norm(), 1.0);
            normal += row * row.transpose() * weight;
            right += row * (error * weight);
            squares += weight * error * error;
            weights += weight;
            distances.push(error.abs());
        }
        let inverse = normal.try_inverse()?;
        let step = inverse * right;
        centre += step.xy();
        radius += step.z;
        let rms = (squares / (weights - 3.0).max(1.0)).sqrt();
        let coverage = agreement(edges, &centre, radius) as f64 / RAYS as f64;
        let covariance_px2 = inverse.fixed_view::<2, 2>(0, 0) * (rms * rms);
        result = Some(Rim { centre_px: centre, covariance_px2, radius_px: radius, coverage, rms_px: rms });
        if step.norm() < 1e-6 {
            break;
        }
        distances.sort_by(f64::total_cmp);
        sigma = (1.4826 * distances.get(distances.len() / 2)?).clamp(0.05, AGREEMENT_PX);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring from 40 to 120 px about (163.4, 117.2), a gap of 60° in its rim, speckle inside.
    fn picture() -> GrayPicture {
        let (width, height) = (320u32, 240u32);
        let shade = |x: f64, y: f64| {
            let (dx, dy) = (x - 163.4, y - 117.2);
            let (radius, angle) = (dx.hypot(dy), dy.atan2(dx));
            let speckle = 30.0 * ((x * 0.31).sin() * (y * 0.27).cos());
            if (40.0..110.0).contains(&radius) {
                130.0 + speckle
            } else if angle.abs() < 0.5 {
                130.0
            } else {
                20.0
            }
        };
        let gray = (0..height)
            .flat_map(|v| (0..width).map(move |u| (u, v)))
            .map(|(u, v)| {
                let samples = (0..16).map(|k| {
                    shade(f64::from(u) + (f64::from(k % 4) - 1.5) / 4.0, f64::from(v) + (f64::from(k / 4) - 1.5) / 4.0)
                });
                (samples.sum::<f64>() / 16.0).round() as u8
            })
            .collect();
        GrayPicture { width, height, gray }
    }

    #[test]
    fn both_rims_are_found_with_their_common_centre() {
        let mut rims = find(&picture(), 2);
        rims.sort_by(|a, b| a.radius_px.total_cmp(&b.radius_px));
        assert_eq!(rims.len(), 2, "{rims:?}");
        for (rim, radius) in rims.iter().zip([40.0, 110.0]) {
            assert!((rim.radius_px - radius).abs() < 0.2, "{rim:?}");
            assert!((rim.centre_px - Vector2::new(163.4, 117.2)).norm() < 0.15, "{rim:?}");
        }
    }

    #[test]
    fn a_picture_without_circles_has_none() {
        let gray = (0..320 * 240).map(|i| if (i % 320) / 20 % 2 == 0 { 40 } else { 200 }).collect();
        assert!(find(&GrayPicture { width: 320, height: 240, gray }, 2).is_empty());
    }
}
