//! Saddles of the gray values: where they are, which way their two edges run, which sectors are bright.

use crate::capture::GrayPicture;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Saddles weaker than this share of the strong ones are noise.
const RELATIVE_STRENGTH: f32 = 0.01;
/// Gray levels of contrast that the weakest corner must have.
const MIN_CONTRAST: f32 = 4.0;
/// Samples of the ring round a candidate.
const RING: usize = 16;

/// A saddle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Saddle {
    /// Pixels.
    pub(super) at: Vector2<f64>,
    /// −det of the second derivatives, gray levels² per px⁴.
    pub(super) strength: f32,
    /// Directions of the two edges (angles from u towards v, mod π): behind the first it turns bright towards larger
    /// angles, behind the second dark.
    pub(super) edges: [f64; 2],
}

/// A blurred picture with its second derivatives.
pub(super) struct Surface {
    pub(super) width: usize,
    pub(super) height: usize,
    gray: Vec<f32>,
    strength: Vec<f32>,
    blur_px: f32,
}

impl Surface {
    pub(super) fn new(picture: &GrayPicture, blur_px: f32) -> Self {
        let (width, height) = (picture.width as usize, picture.height as usize);
        let sharp: Vec<f32> = picture.gray.iter().map(|g| f32::from(*g)).collect();
        let gray = blurred(&sharp, width, height, blur_px);
        let mut strength = vec![0.0; gray.len()];
        for v in 1..height.saturating_sub(1) {
            for u in 1..width - 1 {
                let [xx, xy, yy] = second_derivatives(&gray, width, u, v);
                strength[v * width + u] = xy * xy - xx * yy;
            }
        }
        Self { width, height, gray, strength, blur_px }
    }

    /// All saddles that look like the corner of a board, strongest first.
    pub(super) fn saddles(&self) -> Vec<Saddle> {
        let margin = 4 + self.blur_px as usize;
        let mut found = Vec::new();
        // An ideal corner of contrast c under this blur has |L_xy| = c/(2π·blur²)·2 at its centre.
        let weakest = (MIN_CONTRAST / (std::f32::consts::PI * self.blur_px * self.blur_px)).powi(2);
        for v in margin..self.height.saturating_sub(margin) {
            for u in margin..self.width - margin {
                let s = self.strength[v * self.width + u];
                if s > weakest && self.is_peak(u, v, s) {
                    found.extend(self.saddle_near(Vector2::new(u as f64, v as f64), 1.5));
                }
            }
        }
        found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        let strong = found.get(found.len() / 20).map_or(0.0, |s| s.strength);
        found.retain(|s| s.strength > RELATIVE_STRENGTH * strong && self.looks_like_a_corner(s));
        found
    }

    fn is_peak(&self, u: usize, v: usize, s: f32) -> bool {
        (v - 1..=v + 1).all(|y| {
            (u - 1..=u + 1).all(|x| {
                let other = self.strength[y * self.width + x];
                // Ties go to the first in reading order.
                other < s || (x, y) == (u, v) || (other <= s && (y, x) > (v, u))
            })
        })
    }

    /// The saddle of the blurred surface that a Newton iteration from there reaches, at most `reach_px` away.
    pub(super) fn saddle_near(&self, start: Vector2<f64>, reach_px: f64) -> Option<Saddle> {
        let mut at = start;
        for _ in 0..12 {
            let (gradient, hessian) = self.local_shape(&at)?;
            if hessian.determinant() >= 0.0 {
                return None;
            }
            let step = hessian.try_inverse()? * gradient;
            at -= step * (1.0_f64).min(1.0 / step.norm().max(1e-12));
            if (at - start).norm() > reach_px {
                return None;
            }
            if step.norm() < 1e-3 {
                break;
            }
        }
        let (_, hessian) = self.local_shape(&at)?;
        let strength = -hessian.determinant() as f32;
        (strength > 0.0).then(|| Saddle { at, strength, edges: edges(&hessian) })
    }

    /// Gradient and second derivatives at the nearest pixel, moved there by their Taylor series.
    fn local_shape(&self, at: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (u, v) = (at.x.round(), at.y.round());
        if !(u >= 1.0 && v >= 1.0 && u + 2.0 <= self.width as f64 && v + 2.0 <= self.height as f64) {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let g = |dx: isize, dy: isize| {
            f64::from(self.gray[y.saturating_add_signed(dy) * self.width + x.saturating_add_signed(dx)])
        };
        let gradient = Vector2::new((g(1, 0) - g(-1, 0)) * 0.5, (g(0, 1) - g(0, -1)) * 0.5);
        let [xx, xy, yy] = second_derivatives(&self.gray, self.width, x, y).map(f64::from);
        let hessian = Matrix2::new(xx, xy, xy, yy);
        Some((gradient + hessian * (at - Vector2::new(u, v)), hessian))
    }

    /// Round a corner of a board gray values repeat after half a turn and change four times.
    fn looks_like_a_corner(&self, saddle: &Saddle) -> bool {
        let radius = 2.5 + f64::from(self.blur_px) * 0.5;
        let mut ring = [0.0; RING];
        for (k, value) in ring.iter_mut().enumerate() {
            let angle = std::f64::consts::TAU * k as f64 / RING as f64;
            let Some(gray) = self.gray_at(&(saddle.at + Vector2::new(angle.cos(), angle.sin()) * radius)) else {
                return false;
            };
            *value = gray;
        }
        let mean = ring.iter().sum::<f32>() / RING as f32;
        let (mut even, mut odd) = (0.0, 0.0);
        for k in 0..RING / 2 {
            let (a, b) = (ring[k] - mean, ring[k + RING / 2] - mean);
            even += (a + b) * (a + b);
            odd += (a - b) * (a - b);
        }
        let changes = (0..RING).filter(|k| (ring[*k] > mean) != (ring[(k + 1) % RING] > mean)).count();
        changes == 4 && odd < 0.5 * even
    }

    /// Blurred gray value between pixels; `None` off the picture.
    pub(super) fn gray_at(&self, at: &Vector2<f64>) -> Option<f32> {
        bilinear(at, self.width, self.height, |index| self.gray[index])
    }
}

/// Directions in which a saddle has no curvature, in the order that [`Saddle::edges`] says.
fn edges(hessian: &Matrix2<f64>) -> [f64; 2] {
    // Along angle a the curvature is m + r·cos 2(a − c): positive (bright) between the edges round c.
    let (xx, xy, yy) = (hessian[(0, 0)], hessian[(0, 1)], hessian[(1, 1)]);
    let mean = 0.5 * (xx + yy);
    let (cos, sin) = (0.5 * (xx - yy), xy);
    let r = cos.hypot(sin);
    let centre = 0.5 * sin.atan2(cos);
    let half = 0.5 * (-mean / r).clamp(-1.0, 1.0).acos();
    [centre - half, centre + half]
}

/// The corner in the unblurred picture, near an estimate: the saddle of the quadratic surface that fits a round window,
/// moved with its result until it stays. The window reaches to 45 % of the way to the nearest corner. `None` where the
/// window leaves the picture or the surface is no saddle.
///
/// Source: the polynomial step of ROCHADE (Placht et al., ECCV 2014), which was made for strong distortion.
pub(super) fn refine(picture: &GrayPicture, estimate: Vector2<f64>, nearest_px: f64) -> Option<Vector2<f64>> {
    const REACH_PX: f64 = 2.0;
    let radius = (0.45 * nearest_px).clamp(2.5, 7.0);
    let (width, height) = (picture.width as usize, picture.height as usize);
    let raw = &picture.gray;
    let mut at = estimate;
    for _ in 0..20 {
        let mut normal = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        let (u0, u1) = ((at.x - radius).ceil(), (at.x + radius).floor());
        let (v0, v1) = ((at.y - radius).ceil(), (at.y + radius).floor());
        if u0 < 0.0 || v0 < 0.0 || u1 >= width as f64 || v1 >= height as f64 {
            return None;
        }
        for v in v0 as usize..=v1 as usize {
            for u in u0 as usize..=u1 as usize {
                let (x, y) = (u as f64 - at.x, v as f64 - at.y);
                let weight = 1.0 - x.hypot(y) / radius;
                if weight > 0.0 {
                    let row = SVector::<f64, 6>::new(1.0, x, y, x * x, x * y, y * y);
                    normal.ger(weight, &row, &row, 1.0);
                    right.axpy(weight * f64::from(raw[v * width + u]), &row, 1.0);
                }
            }
        }
        let c = normal.cholesky()?.solve(&right);
        let hessian = Matrix2::new(2.0 * c[3], c[4], c[4], 2.0 * c[5]);
        if hessian.determinant() >= 0.0 {
            return None;
        }
        let step = -hessian.try_inverse()? * Vector2::new(c[1], c[2]);
        at += step * (1.0_f64).min(0.5 / step.norm().max(1e-12));
        if (at - estimate).norm() > REACH_PX {
            return None;
        }
        if step.norm() < 2e-3 {
            return Some(at);
        }
    }
    None
}

fn second_derivatives(gray: &[f32], width: usize, u: usize, v: usize) -> [f32; 3] {
    let g = |x: usize, y: usize| gray[y * width + x];
    let here = 2.0 * g(u, v);
    let xx = g(u + 1, v) - here + g(u - 1, v);
    let yy = g(u, v + 1) - here + g(u, v - 1);
    let xy = 0.25 * (g(u + 1, v + 1) - g(u - 1, v + 1) - g(u + 1, v - 1) + g(u - 1, v - 1));
    [xx, xy, yy]
}

fn bilinear(at: &Vector2<f64>, width: usize, height: usize, value: impl Fn(usize) -> f32) -> Option<f32> {
    if !(at.x >= 0.0 && at.y >= 0.0 && at.x < (width - 1) as f64 && at.y < (height - 1) as f64) {
        return None;
    }
    let (u, v) = (at.x as usize, at.y as usize);
    let (a, b) = ((at.x - u as f64) as f32, (at.y - v as f64) as f32);
    let i = v * width + u;
    let top = value(i) * (1.0 - a) + value(i + 1) * a;
    let bottom = value(i + width) * (1.0 - a) + value(i + width + 1) * a;
    Some(top * (1.0 - b) + bottom * b)
}

/// Separable Gaussian blur; the border repeats.
fn blurred(gray: &[f32], width: usize, height: usize, sigma_px: f32) -> Vec<f32> {
    let radius = (3.0 * sigma_px).ceil() as usize;
    let mut kernel: Vec<f32> =
        (0..=2 * radius).map(|k| (-0.5 * ((k as f32 - radius as f32) / sigma_px).powi(2)).exp()).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let mut rows = vec![0.0; gray.len()];
    let mut padded = vec![0.0; width + 2 * radius];
    for (line, out) in gray.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        padded[..radius].fill(line[0]);
        padded[radius..radius + width].copy_from_slice(line);
        padded[radius + width..].fill(line[width - 1]);
        for (u, value) in out.iter_mut().enumerate() {
            *value = kernel.iter().zip(&padded[u..]).map(|(k, g)| k * g).sum();
        }
    }
    let mut result = vec![0.0; gray.len()];
    for v in 0..height {
        for (k, weight) in kernel.iter().enumerate() {
            let from = (v + k).saturating_sub(radius).min(height - 1) * width;
            for (out, g) in result[v * width..(v + 1) * width].iter_mut().zip(&rows[from..from + width]) {
                *out += weight * g;
            }
        }
    }
    result
}
