//! A camera some of whose numbers a fit may turn.

use std::sync::Arc;

use nalgebra::{DMatrix, Vector2, Vector3};

use super::bundle::ViewPose;
use super::observation::Observations;
use crate::optics::Camera;

/// Differences move pixels by about this much: far above rounding, far below curvature.
const DIFFERENCE_PX: f64 = 1e-3;

/// An unknown of a fit: one number of the camera, or several that are held equal.
#[derive(Debug, Clone, PartialEq)]
pub struct Unknown {
    /// Name of the (first) number, as in `camera.toml`.
    pub name: String,
    /// Which of the camera's numbers.
    indices: Vec<usize>,
}

/// A camera with its unknowns.
#[derive(Debug, Clone)]
pub struct FreeCamera {
    camera: Arc<dyn Camera>,
    values: Vec<f64>,
    unknowns: Vec<Unknown>,
    /// Whether the values make a camera; if not, `camera` is the last that did.
    sound: bool,
    /// Changes of the unknowns for derivatives by differences, once they were sought.
    steps: Option<Vec<f64>>,
}

impl FreeCamera {
    /// Turns the numbers with these names; names joined by `=` are held equal. Names that the camera does not have are
    /// left out.
    pub fn new(camera: Arc<dyn Camera>, free: &[&str]) -> Self {
        let parameters = camera.parameters();
        let index = |name: &str| parameters.iter().position(|p| p.name == name);
        let unknowns = free
            .iter()
            .filter_map(|names| {
                let indices: Vec<usize> = names.split('=').filter_map(index).collect();
                let name = parameters.get(*indices.first()?)?.name.clone();
                Some(Unknown { name, indices })
            })
            .collect();
        Self { values: parameters.iter().map(|p| p.value).collect(), camera, unknowns, sound: true, steps: None }
    }

    /// The camera.
    pub fn camera(&self) -> &Arc<dyn Camera> {
        &self.camera
    }

    /// What is turned.
    pub fn unknowns(&self) -> &[Unknown] {
        &self.unknowns
    }

    /// The unknowns' values.
    pub fn unknown_values(&self) -> Vec<f64> {
        self.unknowns.iter().map(|u| self.values[u.indices[0]]).collect()
    }

    /// Position of an unknown by name.
    pub fn unknown(&self, name: &str) -> Option<usize> {
        self.unknowns.iter().position(|u| u.name == name)
    }

    /// This camera with the numbers of a fit to a simpler variant; `None` where that turned numbers that this one does not
    /// have.
    pub(super) fn with_numbers_of(&self, other: &Self) -> Option<Self> {
        let known = other.camera.parameters();
        let own = self.camera.parameters();
        let has_all = other.unknowns.iter().all(|u| own.iter().any(|p| p.name == u.name));
        if self.camera.model() != other.camera.model() || !has_all {
            return None;
        }
        let values: Vec<f64> =
            own.iter().map(|p| known.iter().find(|k| k.name == p.name).map_or(p.value, |k| k.value)).collect();
        let camera = self.camera.with_values(&values).ok()?;
        Some(Self { camera, values, unknowns: self.unknowns.clone(), sound: true, steps: None })
    }

    /// Turns the unknowns.
    pub(super) fn set_unknowns(&mut self, values: &[f64]) {
        for (unknown, value) in self.unknowns.iter().zip(values) {
            for i in &unknown.indices {
                self.values[*i] = *value;
            }
        }
        let made = values.iter().all(|v| v.is_finite()).then(|| self.camera.with_values(&self.values).ok()).flatten();
        self.sound = made.is_some();
        if let Some(camera) = made {
            self.camera = camera;
        }
    }

    /// Whether the present values make a camera.
    pub(super) fn is_sound(&self) -> bool {
        self.sound
    }

    /// The same with one unknown moved; `None` where that makes no camera.
    fn moved(&self, unknown: usize, by: f64) -> Option<Arc<dyn Camera>> {
        let mut values = self.values.clone();
        for i in &self.unknowns[unknown].indices {
            values[*i] += by;
        }
        self.camera.with_values(&values).ok()
    }

    /// The same with its lengths in pixels times a factor: what is nearer to the picture's centre or farther from it.
    /// `None` where that makes no camera.
    pub(super) fn scaled(&self, factor: f64) -> Option<Self> {
        let mut scaled = self.clone();
        for (parameter, value) in self.camera.parameters().iter().zip(&mut scaled.values) {
            *value *= scale_of(&parameter.name, factor);
        }
        scaled.camera = self.camera.with_values(&scaled.values).ok()?;
        Some(scaled)
    }

    /// Derivatives of a point's image by the unknowns, 2 × unknowns. `None` where it has no image or an unknown moves nothing.
    pub(super) fn point_jacobian(&self, point_m: &Vector3<f64>) -> Option<DMatrix<f64>> {
        let steps = self.steps.clone().or_else(|| self.differences(&[*point_m]))?;
        let mut jacobian = DMatrix::zeros(2, self.unknowns.len());
        for (unknown, step) in steps.into_iter().enumerate() {
            let image = |by: f64| self.moved(unknown, by)?.image_of_point(point_m);
            jacobian.set_column(unknown, &((image(step)? - image(-step)?) / (2.0 * step)));
        }
        Some(jacobian)
    }

    /// Derivatives of all projections by the unknowns at these poses: 2·points × unknowns, view by view, as differences
    /// on both sides.
    pub(super) fn jacobians(&self, observations: &Observations, poses: &[ViewPose]) -> Vec<DMatrix<f64>> {
        let points = in_camera(observations, poses);
        let mut jacobians: Vec<DMatrix<f64>> =
            points.iter().map(|p| DMatrix::zeros(2 * p.len(), self.unknowns.len())).collect();
        let sample = thinned(&points);
        let Some(steps) = self.steps.clone().or_else(|| self.differences(&sample)) else { return jacobians };
        for (unknown, step) in steps.into_iter().enumerate() {
            let (Some(up), Some(down)) = (self.moved(unknown, step), self.moved(unknown, -step)) else { continue };
            for (points, jacobian) in points.iter().zip(&mut jacobians) {
                for (i, point) in points.iter().enumerate() {
                    if let (Some(a), Some(b)) = (up.image_of_point(point), down.image_of_point(point)) {
                        let slope: Vector2<f64> = (a - b) / (2.0 * step);
                        jacobian[(2 * i, unknown)] = slope.x;
                        jacobian[(2 * i + 1, unknown)] = slope.y;
                    }
                }
            }
        }
        jacobians
    }

    /// Seeks the changes for derivatives by differences once, for points as they lie now.
    pub(super) fn seek_steps(&mut self, observations: &Observations, poses: &[ViewPose]) {
        self.steps = self.differences(&thinned(&in_camera(observations, poses)));
    }

    /// For each unknown a change that moves the sample by about [`DIFFERENCE_PX`]; `None` where one moves nothing.
    pub(super) fn differences(&self, sample: &[Vector3<f64>]) -> Option<Vec<f64>> {
        (0..self.unknowns.len()).map(|unknown| self.difference(unknown, sample)).collect()
    }

    /// A change of the unknown that moves the sample by about [`DIFFERENCE_PX`]: units and scales of the numbers differ by
    /// many orders of magnitude.
    fn difference(&self, unknown: usize, sample: &[Vector3<f64>]) -> Option<f64> {
        let value = self.values[self.unknowns[unknown].indices[0]].abs();
        let mut step = if value > 0.0 { 1e-6 * value } else { 1e-12 };
        for _ in 0..30 {
            let moved = self.moved(unknown, step)?;
            let shift = sample
                .iter()
                .filter_map(|p| Some((moved.image_of_point(p)? - self.camera.image_of_point(p)?).norm()))
                .fold(0.0, f64::max);
            if shift > 0.2 * DIFFERENCE_PX && shift < 5.0 * DIFFERENCE_PX {
                return Some(step);
            }
            step *= (DIFFERENCE_PX / shift.max(1e-6 * DIFFERENCE_PX)).clamp(1e-4, 1e4);
        }
        None
    }
}

/// All points in the camera's frame, view by view.
fn in_camera(observations: &Observations, poses: &[ViewPose]) -> Vec<Vec<Vector3<f64>>> {
    let views = observations.views.iter().zip(poses);
    views.map(|(view, pose)| view.points.iter().map(|(object, _)| pose.in_camera(object)).collect()).collect()
}

/// Enough points to see how far pixels move.
fn thinned(points: &[Vec<Vector3<f64>>]) -> Vec<Vector3<f64>> {
    points.iter().flat_map(|p| p.iter().step_by(7)).copied().collect()
}

/// How a number follows when the picture's scale changes: focal lengths with it, a polynomial's coefficient of the power n
/// of the radius with its power 1 − n.
fn scale_of(name: &str, factor: f64) -> f64 {
    if name.starts_with("focal_length") || name.starts_with("inverse") {
        return factor;
    }
    let power = name.strip_prefix("forward[").and_then(|n| n.strip_suffix(']')).and_then(|n| n.parse::<i32>().ok());
    power.map_or(1.0, |n| factor.powi(1 - n))
}
