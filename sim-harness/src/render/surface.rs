//! Surfaces that light meets: where a ray hits them, and where it goes on. In three dimensions, by coefficients and
//! gradients; nothing here knows what a surface is for.

use nalgebra::Vector3;

type V = Vector3<f64>;

/// A quadric of revolution about z: ρ(x² + y²) + a z² + b z + c = 0.
#[derive(Debug, Clone, Copy)]
pub struct Quadric {
    /// Of x² + y².
    pub rho: f64,
    /// Of z².
    pub a: f64,
    /// Of z.
    pub b: f64,
    /// Constant.
    pub c: f64,
}

impl Quadric {
    /// (z − centre)²/a² + sign·(x² + y²)/b² = 1: an ellipsoid (1) or a hyperboloid of two sheets (−1).
    pub fn conic(centre: f64, a2: f64, b2: f64, sign: f64) -> Self {
        Self { rho: sign / b2, a: 1.0 / a2, b: -2.0 * centre / a2, c: centre * centre / a2 - 1.0 }
    }

    /// A sphere about a point of the axis.
    pub fn sphere(centre: f64, radius: f64) -> Self {
        Self::conic(centre, radius * radius, radius * radius, 1.0)
    }

    /// A cone with its apex in the origin.
    pub fn cone(half_angle: f64) -> Self {
        let tan = half_angle.tan();
        Self { rho: 1.0, a: -tan * tan, b: 0.0, c: 0.0 }
    }

    /// x² + y² = 2p·(top − z), which opens down for p > 0.
    pub fn paraboloid(top: f64, p: f64) -> Self {
        Self { rho: 1.0, a: 0.0, b: 2.0 * p, c: -2.0 * p * top }
    }

    /// The plane at a height.
    pub fn plane(z: f64) -> Self {
        Self { rho: 0.0, a: 0.0, b: 1.0, c: -z }
    }

    /// Distances to the intersections, the smaller first; NaN where there is one only.
    pub fn hits(&self, p: &V, d: &V) -> Option<[f64; 2]> {
        let a = self.rho * (d.x * d.x + d.y * d.y) + self.a * d.z * d.z;
        let b = self.rho * (p.x * d.x + p.y * d.y) + self.a * p.z * d.z + 0.5 * self.b * d.z;
        let c = self.rho * (p.x * p.x + p.y * p.y) + self.a * p.z * p.z + self.b * p.z + self.c;
        if a == 0.0 {
            return (b != 0.0).then(|| [-0.5 * c / b, f64::NAN]);
        }
        let root = (b * b - a * c).sqrt();
        if !root.is_finite() {
            return None;
        }
        // The root without cancellation first, the other from the product.
        let large = -(b + root.copysign(b));
        let (t1, t2) = (large / a, c / large);
        Some(if t1 < t2 { [t1, t2] } else { [t2, t1] })
    }

    /// Unit normal, along the gradient.
    pub fn normal(&self, p: &V) -> V {
        V::new(self.rho * p.x, self.rho * p.y, self.a * p.z + 0.5 * self.b).normalize()
    }
}

/// Mirror law.
pub fn reflect(d: &V, n: &V) -> V {
    (d - n * (2.0 * d.dot(n))).normalize()
}

/// Snell's law where light of a direction `d` meets a surface with normal `n` (either way round): `ratio` is the index it
/// comes from over the one it goes to. `None` at total reflection.
pub fn refract(d: &V, n: &V, ratio: f64) -> Option<V> {
    let cos_in = d.dot(n);
    let across = (d - n * cos_in) * ratio;
    let rest = 1.0 - across.norm_squared();
    (rest > 0.0).then(|| (across + n * rest.sqrt().copysign(cos_in)).normalize())
}
