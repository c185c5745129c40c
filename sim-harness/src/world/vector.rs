//! Three single-precision numbers: what the inner loops of the renderer work on. Eight metres in `f32` are exact to half a
//! micrometre, a thousandth of what a pixel shows at arm's length.

use std::ops::{Add, Mul, Neg, Sub};

/// A point or direction, metres, x and y along the floor, z up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct V3 {
    /// Along the room's long side.
    pub x: f32,
    /// Along the short side.
    pub y: f32,
    /// Up.
    pub z: f32,
}

/// A point from its coordinates.
#[inline(always)]
pub const fn v3(x: f32, y: f32, z: f32) -> V3 {
    V3 { x, y, z }
}

impl V3 {
    /// Inner product.
    #[inline(always)]
    pub fn dot(self, o: V3) -> f32 {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    /// Outer product.
    #[inline(always)]
    pub fn cross(self, o: V3) -> V3 {
        v3(self.y * o.z - self.z * o.y, self.z * o.x - self.x * o.z, self.x * o.y - self.y * o.x)
    }

    /// Euclidean length.
    #[inline(always)]
    pub fn length(self) -> f32 {
        self.dot(self).sqrt()
    }

    /// The unit vector of the same direction; not for zero.
    #[inline(always)]
    pub fn unit(self) -> V3 {
        self * (1.0 / self.length())
    }

    /// Turned round the vertical by the angle with this cosine and sine.
    #[inline(always)]
    pub fn turned(self, cos: f32, sin: f32) -> V3 {
        v3(cos * self.x - sin * self.y, sin * self.x + cos * self.y, self.z)
    }
}

impl Add for V3 {
    type Output = V3;
    #[inline(always)]
    fn add(self, o: V3) -> V3 {
        v3(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for V3 {
    type Output = V3;
    #[inline(always)]
    fn sub(self, o: V3) -> V3 {
        v3(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Mul<f32> for V3 {
    type Output = V3;
    #[inline(always)]
    fn mul(self, s: f32) -> V3 {
        v3(self.x * s, self.y * s, self.z * s)
    }
}

impl Neg for V3 {
    type Output = V3;
    #[inline(always)]
    fn neg(self) -> V3 {
        self * -1.0
    }
}

/// A half-line.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Where it starts.
    pub origin: V3,
    /// Unit vector.
    pub direction: V3,
}

impl Ray {
    /// The point `t` metres along.
    #[inline(always)]
    pub fn at(&self, t: f32) -> V3 {
        self.origin + self.direction * t
    }
}
