//! The three solids everything is made of, and where a ray meets them: blocks (furniture), upright cylinders (robots) and
//! capsules (people). Tangency is decided by the distance between ray and axis, not by a discriminant of large numbers, so
//! that an occluding edge stands where geometry puts it to a few micrometres.

use super::vector::{Ray, V3, v3};

/// A box standing level, turned round the vertical.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// Middle.
    pub centre: V3,
    /// Half of width (own x), depth (own y), height.
    pub half: V3,
    /// Cosine and sine of the turn.
    pub turn: [f32; 2],
}

/// Faces of a block: own +x, −x, +y, −y, +z, −z.
pub const FACES: usize = 6;

impl Block {
    /// From the middle of its foot, turn, size and height of the foot above the floor.
    pub fn new(x: f32, y: f32, bottom: f32, yaw: f32, width: f32, depth: f32, height: f32) -> Self {
        Self {
            centre: v3(x, y, bottom + 0.5 * height),
            half: v3(0.5 * width, 0.5 * depth, 0.5 * height),
            turn: [yaw.cos(), yaw.sin()],
        }
    }

    /// A point in the block's own axes.
    #[inline(always)]
    pub fn local(&self, p: V3) -> V3 {
        (p - self.centre).turned(self.turn[0], -self.turn[1])
    }

    /// Entry distance and face of a ray from outside, nearer than `limit`.
    #[inline(always)]
    pub fn hit(&self, ray: &Ray, limit: f32) -> Option<(f32, usize)> {
        let o = self.local(ray.origin);
        let d = ray.direction.turned(self.turn[0], -self.turn[1]);
        let (mut near, mut far, mut face) = (0.0f32, limit, FACES);
        for (axis, (o, d, h)) in
            [(o.x, d.x, self.half.x), (o.y, d.y, self.half.y), (o.z, d.z, self.half.z)].into_iter().enumerate()
        {
            let inverse = 1.0 / d;
            let (a, b) = ((-h - o) * inverse, (h - o) * inverse);
            let (enter, leave) = if a < b { (a, b) } else { (b, a) };
            if enter > near {
                near = enter;
                face = 2 * axis + usize::from(d > 0.0);
            }
            far = far.min(leave);
        }
        (near < far && face < FACES).then_some((near, face))
    }

    /// Outer normal of a face.
    pub fn normal(&self, face: usize) -> V3 {
        let sign = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        let own = match face / 2 {
            0 => v3(sign, 0.0, 0.0),
            1 => v3(0.0, sign, 0.0),
            _ => v3(0.0, 0.0, sign),
        };
        own.turned(self.turn[0], self.turn[1])
    }

    /// Radius of the circle round the block seen from above.
    pub fn circle(&self) -> f32 {
        self.half.x.hypot(self.half.y)
    }
}

/// A closed cylinder with a vertical axis.
#[derive(Debug, Clone, Copy)]
pub struct Upright {
    /// Axis.
    pub x: f32,
    /// Axis.
    pub y: f32,
    /// Of the circle.
    pub radius: f32,
    /// Lower end above the floor.
    pub low: f32,
    /// Upper end above the floor.
    pub high: f32,
}

impl Upright {
    /// Entry distance and outer normal of a ray from outside, nearer than `limit`.
    #[inline(always)]
    pub fn hit(&self, ray: &Ray, limit: f32) -> Option<(f32, V3)> {
        let (dx, dy) = (ray.direction.x, ray.direction.y);
        let (ox, oy) = (ray.origin.x - self.x, ray.origin.y - self.y);
        let aa = dx * dx + dy * dy;
        let cross = ox * dy - oy * dx;
        let room = self.radius * self.radius * aa - cross * cross;
        if room <= 0.0 {
            return None;
        }
        let middle = -(ox * dx + oy * dy) / aa;
        let half = room.sqrt() / aa;
        let side = middle - half;
        let z = ray.origin.z + side * ray.direction.z;
        if side > 0.0 && z >= self.low && z <= self.high {
            let normal = v3(ox + side * dx, oy + side * dy, 0.0) * (1.0 / self.radius);
            return (side < limit).then_some((side, normal));
        }
        let (plane, up) = if z > self.high { (self.high, 1.0) } else { (self.low, -1.0) };
        let t = (plane - ray.origin.z) / ray.direction.z;
        (t > side.max(0.0) && t < middle + half && t < limit).then_some((t, v3(0.0, 0.0, up)))
    }
}

/// All points within `radius` of a segment.
#[derive(Debug, Clone, Copy)]
pub struct Capsule {
    /// One end of the segment.
    pub a: V3,
    /// Other end.
    pub b: V3,
    /// Distance.
    pub radius: f32,
}

impl Capsule {
    /// Entry distance of a ray from outside, nearer than `limit`.
    #[inline(always)]
    pub fn hit(&self, ray: &Ray, limit: f32) -> Option<f32> {
        let axis = self.b - self.a;
        let from = ray.origin - self.a;
        let (d, r2) = (ray.direction, self.radius * self.radius);
        let len2 = axis.dot(axis);
        if len2 > 1e-12 {
            let across = d.cross(axis);
            let n2 = across.dot(across);
            if n2 > 1e-12 {
                let apart = from.dot(across);
                let room = r2 * n2 - apart * apart;
                if room <= 0.0 {
                    return None;
                }
                // The ray meets the infinite cylinder where its distance to the axis line is the radius.
                let from_across = from.cross(axis);
                let middle = -from_across.dot(across) / n2;
                let t = middle - (len2 * room).sqrt() / n2;
                let along = (from + d * t).dot(axis);
                if along >= 0.0 && along <= len2 {
                    return (t > 0.0 && t < limit).then_some(t);
                }
                let end = if along < 0.0 { self.a } else { self.b };
                return ball(end, r2, ray, limit);
            }
        }
        let (a, b) = (ball(self.a, r2, ray, limit), ball(self.b, r2, ray, limit));
        match (a, b) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }

    /// Where along the axis (0 at `a`, 1 at `b`) a surface point sits, and its outer normal.
    #[inline(always)]
    pub fn surface(&self, p: V3) -> (f32, V3) {
        let axis = self.b - self.a;
        let s = ((p - self.a).dot(axis) / axis.dot(axis).max(1e-12)).clamp(0.0, 1.0);
        (s, (p - (self.a + axis * s)) * (1.0 / self.radius))
    }

    /// Volume.
    pub fn volume(&self) -> f32 {
        std::f32::consts::PI * self.radius * self.radius * ((self.b - self.a).length() + 4.0 / 3.0 * self.radius)
    }
}

#[inline(always)]
fn ball(centre: V3, r2: f32, ray: &Ray, limit: f32) -> Option<f32> {
    let from = ray.origin - centre;
    let across = from.cross(ray.direction);
    let room = r2 - across.dot(across);
    if room <= 0.0 {
        return None;
    }
    let t = -from.dot(ray.direction) - room.sqrt();
    (t > 0.0 && t < limit).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: V3, towards: V3) -> Ray {
        Ray { origin, direction: (towards - origin).unit() }
    }

    #[test]
    fn a_ray_meets_a_capsule_where_it_is_one_radius_from_the_axis() {
        let capsule = Capsule { a: v3(2.0, -0.3, 0.1), b: v3(2.4, 0.5, 1.2), radius: 0.11 };
        let mut hits = 0;
        for i in 0..4000 {
            let ray = ray(v3(0.0, 0.1, 0.6), v3(2.2, -0.6 + 0.0003 * i as f32, 0.2 + 0.0003 * i as f32));
            if let Some(t) = capsule.hit(&ray, 100.0) {
                let (_, normal) = capsule.surface(ray.at(t));
                assert!((normal.length() - 1.0).abs() < 1e-4, "{normal:?}");
                assert!(normal.dot(ray.direction) < 0.0);
                hits += 1;
            }
        }
        assert!(hits > 50);
    }

    #[test]
    fn a_level_ray_grazes_a_cylinder_at_the_tangent() {
        let body = Upright { x: 3.0, y: 0.0, radius: 0.2, low: 0.02, high: 0.5 };
        let tangent = (0.2f32 / 3.0).asin();
        for (offset, hits) in [(-1e-5, true), (1e-5, false)] {
            let a = tangent + offset;
            let ray = Ray { origin: v3(0.0, 0.0, 0.3), direction: v3(a.cos(), a.sin(), 0.0) };
            assert_eq!(body.hit(&ray, 100.0).is_some(), hits, "{offset}");
        }
    }

    #[test]
    fn a_ray_from_above_meets_the_top_of_a_cylinder() {
        let body = Upright { x: 1.0, y: 0.0, radius: 0.2, low: 0.0, high: 0.5 };
        let (t, normal) = body.hit(&ray(v3(0.0, 0.0, 1.5), v3(1.0, 0.0, 0.5)), 10.0).unwrap();
        assert!((t - 2f32.sqrt()).abs() < 1e-5);
        assert_eq!(normal, v3(0.0, 0.0, 1.0));
    }

    #[test]
    fn a_turned_block_is_met_on_the_face_towards_the_ray() {
        let block = Block::new(2.0, 0.0, 0.0, std::f32::consts::FRAC_PI_2, 0.4, 1.0, 1.0);
        let (t, face) = block.hit(&ray(v3(0.0, 0.0, 0.5), v3(1.0, 0.0, 0.5)), 10.0).unwrap();
        assert!((t - 1.5).abs() < 1e-5);
        assert!((block.normal(face) - v3(-1.0, 0.0, 0.0)).length() < 1e-6);
    }
}
