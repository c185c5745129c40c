//! An optical bench: a camera looks at one surface after another, and every ray of its picture is followed out.
//!
//! Rays are carried in three dimensions, as light would go backwards: intersection, normal, reflection or refraction.
//! Nothing uses half-angle theorems, foci or caustics; what cameras have of them is what the tests observe. Lengths in
//! mm, in the frame of the model in `camera.toml`.

use nalgebra::Vector3;

use super::surface::{Quadric, reflect, refract};

type V = Vector3<f64>;

/// What light does at a surface.
#[derive(Debug, Clone, Copy)]
pub enum Element {
    /// Reflected where it first meets the surface at a height between the two.
    Mirror(Quadric, [f64; 2]),
    /// Bent there; the ratio is the index before over the index behind, as the traced ray goes.
    Window(Quadric, [f64; 2], f64),
    /// Bent at n|R| − |R − (0, 0, t)| = C, out of the glass.
    Oval {
        /// Index of the glass.
        n: f64,
        /// Height of the second point, mm.
        t: f64,
        /// Path difference, mm.
        c: f64,
    },
}

/// The camera that looks at the elements.
#[derive(Debug, Clone, Copy)]
pub enum Eye {
    /// A pinhole at a height with a focal length in px.
    Pinhole(f64, f64),
    /// A telecentric camera at a height with its magnification in px/mm.
    Telecentric(f64, f64),
}

/// A camera and its elements.
#[derive(Debug, Clone)]
pub struct Bench {
    /// The camera.
    pub eye: Eye,
    /// Whether it looks up.
    pub looks_up: bool,
    /// Whether light crosses the axis an odd number of times between the picture's side and the world's: then the
    /// sensor's axes are turned by 180°, so that straight ahead is at u > u₀ as for every camera.
    pub crosses: bool,
    /// Where the axis meets the picture.
    pub centre_px: [f64; 2],
    /// What light meets, from the camera outwards.
    pub elements: Vec<Element>,
}

/// A ray out into the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutwardRay {
    /// Where it leaves the last element, mm.
    pub origin_mm: V,
    /// Unit vector.
    pub direction: V,
}

impl Bench {
    /// The ray of a point of the picture; `None` where light is lost.
    pub fn trace(&self, u_px: f64, v_px: f64) -> Option<OutwardRay> {
        let turn = if self.crosses { -1.0 } else { 1.0 };
        let (x, y) = (turn * (u_px - self.centre_px[0]), turn * (v_px - self.centre_px[1]));
        let along = if self.looks_up { 1.0 } else { -1.0 };
        let (mut p, mut d) = match self.eye {
            Eye::Pinhole(z, f) => (V::new(0.0, 0.0, z), V::new(x, y, along * f).normalize()),
            Eye::Telecentric(z, m) => (V::new(x / m, y / m, z), V::new(0.0, 0.0, along)),
        };
        for element in &self.elements {
            (p, d) = element.meet(&p, &d)?;
        }
        Some(OutwardRay { origin_mm: p, direction: d })
    }
}

impl Element {
    fn meet(&self, p: &V, d: &V) -> Option<(V, V)> {
        match self {
            Self::Mirror(surface, heights) => {
                let at = first(surface, heights, p, d)?;
                Some((at, reflect(d, &surface.normal(&at))))
            }
            Self::Window(surface, heights, ratio) => {
                let at = first(surface, heights, p, d)?;
                Some((at, refract(d, &surface.normal(&at), *ratio)?))
            }
            Self::Oval { n, t, c } => {
                let other = V::new(0.0, 0.0, *t);
                let value = |r: &V| n * r.norm() - (r - other).norm() - c;
                let gradient = |r: &V| r.normalize() * *n - (r - other).normalize();
                // Inside it is negative, far outside positive: bisect, then Newton to the last bit.
                let (mut low, mut high) = (0.0, 1e3);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if value(&(p + d * middle)) < 0.0 { low = middle } else { high = middle }
                }
                let mut s = 0.5 * (low + high);
                for _ in 0..3 {
                    let r = p + d * s;
                    s -= value(&r) / gradient(&r).dot(d);
                }
                let at = p + d * s;
                Some((at, refract(d, &gradient(&at).normalize(), *n)?))
            }
        }
    }
}

/// The first point ahead on a surface between two heights.
fn first(surface: &Quadric, heights: &[f64; 2], p: &V, d: &V) -> Option<V> {
    let ahead = surface.hits(p, d)?.into_iter().filter(|t| *t > 1e-9).map(|t| p + d * t);
    ahead.into_iter().find(|at| at.z >= heights[0] && at.z <= heights[1])
}
