//! What a calibration has to say: in words for people, in numbers for programs.

use nalgebra::{DMatrix, Matrix2, Vector2};
use serde_json::{Value, json};

use super::axis::{self, SharedAxis};
use super::bundle::{CameraCovariance, CovarianceSource};
use super::free_camera::FreeCamera;
use super::observation::Observations;
use super::selection::{Judged, Selection};
use crate::optics::{bearing_rad, elevation_rad};

/// A point this far along the axis is at infinity, metres.
const FAR_M: f64 = 1e3;
/// Other models whose error on unseen views is at most this many times the chosen one's fit nearly as well.
const AS_GOOD: f64 = 1.25;
/// Cells of the picture, along each side, that coverage is counted in.
const CELLS: usize = 12;
/// An unseen view may be this much worse than the fit before the fit is called too rich for its data.
const OVERFIT: f64 = 1.15;

/// A finished calibration with everything that is told about it.
#[derive(Debug)]
pub struct Summary<'a> {
    /// What it was made from.
    pub observations: &'a Observations,
    /// The candidates and the choice.
    pub selection: &'a Selection,
    /// Of the chosen camera; `None` where the data does not determine all of its unknowns.
    pub covariance: Option<CameraCovariance>,
}

/// The chosen camera's axis as another model has it.
#[derive(Debug, Clone)]
pub struct OtherAxis<'a> {
    /// The other candidate.
    pub name: &'a str,
    /// Where that one has its own axis, px.
    pub centre_px: Vector2<f64>,
    /// How its axis lies to the chosen camera's, and where it images the latter.
    pub shared: SharedAxis,
}

/// How well the camera knows the ray of a pixel.
#[derive(Debug, Clone, Copy)]
pub struct RaySigma {
    /// Distance from the picture's centre, px.
    pub radius_px: f64,
    /// Elevation of the ray, radians.
    pub elevation_rad: f64,
    /// Standard deviation of its bearing, radians.
    pub bearing_sigma_rad: f64,
    /// Standard deviation of its elevation, radians.
    pub elevation_sigma_rad: f64,
    /// Standard deviation of the pixel (larger axis) at which its direction appears, px.
    pub pixel_sigma_px: f64,
    /// Pixels per radian of elevation.
    pub px_per_rad: f64,
}

impl<'a> Summary<'a> {
    /// Collects what there is to say.
    pub fn new(observations: &'a Observations, selection: &'a Selection) -> Self {
        Self { observations, selection, covariance: selection.best().fit.covariance() }
    }

    /// The chosen candidate.
    pub fn best(&self) -> &Judged {
        self.selection.best()
    }

    /// The findings, most important first.
    pub fn words(&self) -> Vec<String> {
        let best = self.best();
        let fit = &best.fit;
        let mut words = vec![format!(
            "{}: rms {:.3} px, mean {:.3} px over {} points in {} views.",
            best.name,
            fit.rms_px(),
            fit.mean_px(),
            self.observations.points(),
            self.observations.views.len()
        )];
        match best.unseen_rms_px {
            Some(unseen) if unseen > OVERFIT * fit.weighted_rms_px() => words.push(format!(
                "On views that the fit had not seen the error is {unseen:.3} px, {:.0} % more than on its own: the model is too \
                 rich for this data. Take more views.",
                100.0 * (unseen / fit.weighted_rms_px() - 1.0)
            )),
            Some(unseen) => words.push(format!("On views that the fit had not seen the error is {unseen:.3} px.")),
            None => words.push("Too few views to leave some out: the model was not tested on unseen ones.".into()),
        }
        words.extend(self.misalignment());
        if let Some(other) = self.selection.dissent() {
            words.push(format!(
                "The information criterion alone would take \"{other}\"; unseen views do not support that."
            ));
        }
        match self.covariance.as_ref().map(|c| c.source) {
            Some(CovarianceSource::Views { inflation }) => words.push(format!(
                "The views contradict each other by {:.1} times what their points' noise explains (a bent board, or a model that \
                 is a little wrong): the sigmas are from the scatter of the views.",
                inflation.sqrt()
            )),
            Some(CovarianceSource::Points) => {
                words.push("The views scatter no more than their points' noise explains.".into());
            }
            None => words.push("Not every unknown is determined by this data: there is no covariance.".into()),
        }
        words.extend(fit.undetermined());
        if fit.outliers() > 0 {
            let worst = fit.residuals_px.iter().enumerate().max_by(|a, b| rms(a.1).total_cmp(&rms(b.1)));
            let worst = worst.map_or(String::new(), |(v, r)| {
                format!("; the worst view is {:?} with rms {:.2} px", self.observations.views[v].name, rms(r))
            });
            words.push(format!("{} points count less because they lie far off{worst}.", fit.outliers()));
        }
        let empty = self.empty_share();
        if empty > 0.3 {
            words.push(format!(
                "{:.0} % of the part of the picture that the points span has none: the camera is extrapolated there.",
                100.0 * empty
            ));
        }
        words
    }

    /// The picture's centre: where the axis of the chosen camera's optics is imaged, px.
    pub fn centre_px(&self) -> Vector2<f64> {
        centre_px(self.best())
    }

    /// Covariance of the centre as the chosen model has it, px²; `None` without a covariance. What other models make of the
    /// same rays is in [`Summary::axes`].
    pub fn centre_covariance_px2(&self) -> Option<Matrix2<f64>> {
        let camera = &self.best().fit.camera;
        let far = axis::direction(camera.camera().as_ref()) * FAR_M;
        let jacobian = camera.point_jacobian(&far)?;
        let covariance = &jacobian * &self.covariance.as_ref()?.matrix * jacobian.transpose();
        Some(Matrix2::new(covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 0)], covariance[(1, 1)]))
    }

    /// The chosen camera's axis in each other candidate that fits unseen views as well to within a quarter and is misaligned
    /// where the chosen one is: what the centre would be had that model been chosen, and where it images the same direction.
    pub fn axes(&self) -> Vec<OtherAxis<'a>> {
        let best = self.best();
        let limit = best.unseen_rms_px.map_or(f64::INFINITY, |rms| AS_GOOD * rms);
        let others = self.selection.judged.iter().filter(|j| j.name != best.name);
        others
            .filter(|j| j.unseen_rms_px.unwrap_or(f64::INFINITY) <= limit)
            .filter_map(|j| {
                let pixels = self.observations.views.iter().flat_map(|v| &v.points).map(|(_, pixel)| *pixel);
                let camera = j.fit.camera.camera().as_ref();
                let shared = axis::shared(best.fit.camera.camera().as_ref(), camera, pixels)?;
                Some(OtherAxis { name: &j.name, centre_px: centre_px(j), shared })
            })
            .collect()
    }

    /// Whether the camera had to be set askew to its optics, and what that makes of its centre.
    fn misalignment(&self) -> Vec<String> {
        let Some((with, without)) = self.selection.misaligned() else { return Vec::new() };
        let (Some(a), Some(b)) = (with.unseen_rms_px, without.unseen_rms_px) else { return Vec::new() };
        let mut words = vec![format!(
            "The mirror or lens is misaligned against the sensor: without tangential terms the error is {b:.2} px instead of {a:.2} \
             px, and the centre lies {:.1} px elsewhere.",
            (centre_px(with) - centre_px(without)).norm()
        )];
        let away = |o: &OtherAxis| (o.centre_px - self.centre_px()).norm();
        if let Some(other) = self.axes().into_iter().max_by(|a, b| away(a).total_cmp(&away(b))) {
            let same = other.shared.image_px.map_or(f64::NAN, |px| (px - self.centre_px()).norm());
            words.push(format!(
                "Of a misaligned camera the centre (the image of its axis) depends on the model: \"{}\", which fits nearly as \
                 well, has it {:.1} px away, its axis turned by {:.2}°. Turned back, its rays differ by {:.3}° rms and it images \
                 this axis {same:.1} px away. `calibrate mounting` takes up such a turn.",
                other.name,
                away(&other),
                other.shared.turn_rad.to_degrees(),
                other.shared.disagreement_rad.to_degrees(),
            ));
        }
        words
    }

    /// Counts of points in cells of the picture, row by row.
    pub fn coverage(&self) -> Vec<Vec<usize>> {
        let [w, h] = self.observations.image_size_px.map(f64::from);
        let mut cells = vec![vec![0; CELLS]; CELLS];
        for (_, pixel) in self.observations.views.iter().flat_map(|v| &v.points) {
            let cell = |x: f64, n: f64| (((x + 0.5) / n * CELLS as f64) as usize).min(CELLS - 1);
            cells[cell(pixel.y, h)][cell(pixel.x, w)] += 1;
        }
        cells
    }

    /// Share of the cells between the innermost and outermost point that have none.
    fn empty_share(&self) -> f64 {
        let [w, h] = self.observations.image_size_px.map(f64::from);
        let centre = self.centre_px();
        let radii: Vec<f64> =
            self.observations.views.iter().flat_map(|v| &v.points).map(|(_, p)| (p - centre).norm()).collect();
        let (low, high) = radii.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), r| (l.min(*r), h.max(*r)));
        let (mut all, mut empty) = (0, 0);
        for (j, row) in self.coverage().iter().enumerate() {
            for (i, count) in row.iter().enumerate() {
                let middle = |k: usize, n: f64| (k as f64 + 0.5) / CELLS as f64 * n - 0.5;
                let radius = (Vector2::new(middle(i, w), middle(j, h)) - centre).norm();
                if radius > low && radius < high {
                    all += 1;
                    empty += usize::from(*count == 0);
                }
            }
        }
        empty as f64 / all.max(1) as f64
    }

    /// How well rays are known, from the centre outwards along the picture's u axis, over the radii where points were.
    pub fn rays(&self) -> Vec<RaySigma> {
        const STEPS: u32 = 40;
        let camera = &self.best().fit.camera;
        let centre = self.centre_px();
        let reach = self
            .observations
            .views
            .iter()
            .flat_map(|v| &v.points)
            .map(|(_, p)| (p - centre).norm())
            .fold(0.0, f64::max);
        let Some(covariance) = &self.covariance else { return Vec::new() };
        (1..=STEPS)
            .filter_map(|i| {
                let radius_px = reach * f64::from(i) / f64::from(STEPS);
                ray_sigma(camera, &covariance.matrix, centre, radius_px)
            })
            .collect()
    }

    /// Everything as JSON.
    pub fn json(&self) -> Value {
        let best = self.best();
        let unknowns: Vec<Value> = best
            .fit
            .camera
            .unknowns()
            .iter()
            .zip(best.fit.camera.unknown_values())
            .enumerate()
            .map(|(i, (u, value))| {
                json!({ "name": u.name, "value": value, "sigma": self.covariance.as_ref().map(|c| c.sigma(i)) })
            })
            .collect();
        let candidates: Vec<Value> = self
            .selection
            .judged
            .iter()
            .map(|j| {
                json!({
                    "name": j.name, "unknowns": j.fit.camera.unknowns().len(), "rms_px": j.fit.rms_px(),
                    "mean_px": j.fit.mean_px(), "unseen_rms_px": j.unseen_rms_px,
                    "information_criterion": j.information_criterion,
                })
            })
            .collect();
        let views: Vec<Value> = self
            .observations
            .views
            .iter()
            .zip(&best.fit.residuals_px)
            .map(|(v, r)| json!({ "name": v.name, "points": v.points.len(), "rms_px": rms(r) }))
            .collect();
        let rays: Vec<Value> = self
            .rays()
            .iter()
            .map(|r| {
                json!({
                    "radius_px": r.radius_px, "elevation_deg": r.elevation_rad.to_degrees(),
                    "bearing_sigma_deg": r.bearing_sigma_rad.to_degrees(),
                    "elevation_sigma_deg": r.elevation_sigma_rad.to_degrees(),
                    "pixel_sigma_px": r.pixel_sigma_px, "px_per_deg": r.px_per_rad.to_radians(),
                })
            })
            .collect();
        let axes: Vec<Value> = self
            .axes()
            .iter()
            .map(|o| {
                json!({
                    "name": o.name, "centre_px": o.centre_px.as_slice(), "turn_deg": o.shared.turn_rad.to_degrees(),
                    "disagreement_deg": o.shared.disagreement_rad.to_degrees(),
                    "image_of_axis_px": o.shared.image_px.map(|px| [px.x, px.y]),
                })
            })
            .collect();
        let covariance = self
            .covariance
            .as_ref()
            .map(|c| c.matrix.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>()).collect::<Vec<_>>());
        json!({
            "model": best.fit.camera.camera().model(),
            "variant": best.name,
            "findings": self.words(),
            "image_size_px": self.observations.image_size_px,
            "points": self.observations.points(),
            "rms_px": best.fit.rms_px(),
            "mean_px": best.fit.mean_px(),
            "sigma_px": best.fit.sigma_px,
            "unseen_rms_px": best.unseen_rms_px,
            "outliers": best.fit.outliers(),
            "centre_px": self.centre_px().as_slice(),
            "centre_covariance_px2": self.centre_covariance_px2().map(|c| [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]]),
            "axes": axes,
            "unknowns": unknowns,
            "covariance": covariance,
            "undetermined": best.fit.undetermined(),
            "views": views,
            "candidates": candidates,
            "failed": self.selection.failed.iter().map(|(n, e)| json!({"name": n, "reason": e.to_string()})).collect::<Vec<_>>(),
            "rays": rays,
        })
    }
}

fn ray_sigma(camera: &FreeCamera, covariance: &DMatrix<f64>, centre: Vector2<f64>, radius_px: f64) -> Option<RaySigma> {
    let pixel = centre + Vector2::new(radius_px, 0.0);
    let ray = camera.camera().ray_of_image(&pixel)?;
    let far = ray.origin_m + ray.direction * 1e3;
    let by_pixel = camera.point_jacobian(&far)?;
    let pixel_covariance: Matrix2<f64> = {
        let c = &by_pixel * covariance * by_pixel.transpose();
        Matrix2::new(c[(0, 0)], c[(0, 1)], c[(1, 0)], c[(1, 1)])
    };
    // Pixel to angle at this place, by differences.
    let angle = |p: Vector2<f64>| {
        let d = camera.camera().ray_of_image(&p)?.direction;
        Some((bearing_rad(&d), elevation_rad(&d)))
    };
    let step = 0.25;
    let mut slope = Matrix2::zeros();
    for (k, offset) in [Vector2::new(step, 0.0), Vector2::new(0.0, step)].into_iter().enumerate() {
        let ((b1, e1), (b0, e0)) = (angle(pixel + offset)?, angle(pixel - offset)?);
        slope[(0, k)] = protocol::angle::wrap(b1 - b0) / (2.0 * step);
        slope[(1, k)] = (e1 - e0) / (2.0 * step);
    }
    let angles = slope * pixel_covariance * slope.transpose();
    Some(RaySigma {
        radius_px,
        elevation_rad: elevation_rad(&ray.direction),
        bearing_sigma_rad: angles[(0, 0)].max(0.0).sqrt(),
        elevation_sigma_rad: angles[(1, 1)].max(0.0).sqrt(),
        pixel_sigma_px: pixel_covariance.symmetric_eigenvalues().max().max(0.0).sqrt(),
        px_per_rad: slope[(1, 0)].abs().max(1e-12).recip(),
    })
}

/// Where the axis is imaged; the parameter of that name where the optics see nothing there.
fn centre_px(judged: &Judged) -> Vector2<f64> {
    let camera = &judged.fit.camera;
    axis::image_px(camera.camera().as_ref()).unwrap_or_else(|| Vector2::from(numbers(camera, "centre_px")))
}

fn numbers(camera: &FreeCamera, key: &str) -> [f64; 2] {
    let parameters = camera.camera().parameters();
    let get = |i: usize| parameters.iter().find(|p| p.name == format!("{key}[{i}]")).map_or(0.0, |p| p.value);
    [get(0), get(1)]
}

fn rms(residuals: &[Vector2<f64>]) -> f64 {
    (residuals.iter().map(Vector2::norm_squared).sum::<f64>() / residuals.len().max(1) as f64).sqrt()
}
