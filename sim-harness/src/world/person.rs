//! A person's body: head, neck, trunk, swinging arms and legs with feet, as capsules, from height and gait.
//!
//! The body is measured in parts of a person of 1.75 m and scaled. Legs swing from the hips with knees that bend while a
//! leg comes forward; arms swing against them; the hips are at the height at which the lower foot stands on the floor.

use super::solid::Capsule;
use super::vector::{V3, v3};

/// Number of capsules of a person.
pub const PARTS: usize = 16;
/// Height of the person whose measures stand in the code.
const MEASURED_M: f32 = 1.75;

/// What covers a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cover {
    /// Face and hands.
    Skin,
    /// Top.
    Shirt,
    /// Trousers.
    Trousers,
    /// Shoes.
    Shoes,
}

/// What each capsule of [`capsules`] is covered with.
pub const COVERS: [Cover; PARTS] = [
    Cover::Skin, // head
    Cover::Skin, // neck
    Cover::Shirt,
    Cover::Shirt,
    Cover::Shirt, // trunk left, right, shoulders
    Cover::Shirt,
    Cover::Shirt, // upper arms
    Cover::Shirt,
    Cover::Shirt, // forearms
    Cover::Skin,  // hands are one part with the left; see `capsules`
    Cover::Trousers,
    Cover::Trousers, // thighs
    Cover::Trousers,
    Cover::Trousers, // shins
    Cover::Shoes,
    Cover::Shoes, // feet
];

/// How somebody stands or walks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gait {
    /// Room frame.
    pub x_m: f64,
    /// Room frame.
    pub y_m: f64,
    /// Counter-clockwise from the room's x.
    pub heading_rad: f64,
    /// Of the stride, radians; the left leg is foremost at π/2.
    pub phase_rad: f64,
    /// Swing of the legs from the vertical, radians.
    pub swing_rad: f64,
}

/// The body's capsules, in the order of [`COVERS`].
pub fn capsules(gait: &Gait, height_m: f64) -> [Capsule; PARTS] {
    let (phase, swing) = (gait.phase_rad as f32, gait.swing_rad as f32);
    let leg = |side: f32| {
        let hip = v3(0.0, side * 0.09, 0.0);
        let turn = swing * (phase.sin() * side);
        // The knee bends while the leg comes forward.
        let bend = swing * 1.1 * (phase.cos() * side).max(0.0) + 0.06;
        let knee = hip + v3(turn.sin(), 0.0, -turn.cos()) * 0.43;
        let shin = turn - bend;
        let ankle = knee + v3(shin.sin(), 0.0, -shin.cos()) * 0.42;
        (hip, knee, ankle, ankle + v3(0.17, side * 0.02, -0.01))
    };
    let (left, right) = (leg(1.0), leg(-1.0));
    let hips_z = 0.04 - left.2.z.min(right.2.z);
    let arm = |side: f32| {
        let shoulder = v3(0.0, side * 0.205, 0.45);
        let turn = -0.85 * swing * phase.sin() * side;
        let elbow = shoulder + v3(turn.sin(), side * 0.10, -turn.cos()) * 0.29;
        let fore = turn + 0.25 + 0.5 * swing;
        let hand = elbow + v3(fore.sin(), side * 0.02, -fore.cos()) * 0.27;
        (shoulder, elbow, hand)
    };
    let (arm_l, arm_r) = (arm(1.0), arm(-1.0));
    let scale = height_m as f32 / MEASURED_M;
    let (sin, cos) = (gait.heading_rad as f32).sin_cos();
    let foot = v3(gait.x_m as f32, gait.y_m as f32, 0.0);
    let place = |p: V3| foot + ((p + v3(0.0, 0.0, hips_z)) * scale).turned(cos, sin);
    let part = |a: V3, b: V3, radius: f32| Capsule { a: place(a), b: place(b), radius: radius * scale };
    // The top of the head is 0.865 above hips that stand 0.885 high.
    [
        part(v3(0.01, 0.0, 0.72), v3(0.02, 0.0, 0.77), 0.095),
        part(v3(0.0, 0.0, 0.50), v3(0.01, 0.0, 0.66), 0.055),
        part(v3(0.0, 0.07, 0.03), v3(0.0, 0.085, 0.40), 0.112),
        part(v3(0.0, -0.07, 0.03), v3(0.0, -0.085, 0.40), 0.112),
        part(v3(0.0, -0.15, 0.44), v3(0.0, 0.15, 0.44), 0.078),
        part(arm_l.0, arm_l.1, 0.048),
        part(arm_r.0, arm_r.1, 0.048),
        part(arm_l.1, arm_l.2, 0.040),
        part(arm_r.1, arm_r.2, 0.040),
        part(arm_l.2, arm_l.2 + v3(0.03, 0.0, -0.05), 0.040),
        part(left.0, left.1, 0.078),
        part(right.0, right.1, 0.078),
        part(left.1, left.2, 0.052),
        part(right.1, right.2, 0.052),
        part(left.2, left.3, 0.040),
        part(right.2, right.3, 0.040),
    ]
}

/// The centroid of the body's volume (capsules counted one by one: joints overlap a little).
pub fn centroid(parts: &[Capsule; PARTS]) -> V3 {
    let (sum, weight) = parts.iter().fold((v3(0.0, 0.0, 0.0), 0.0f32), |(sum, weight), c| {
        let volume = c.volume();
        (sum + (c.a + c.b) * (0.5 * volume), weight + volume)
    });
    sum * (1.0 / weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing(height_m: f64) -> [Capsule; PARTS] {
        capsules(&Gait { x_m: 1.0, y_m: 2.0, heading_rad: 0.7, phase_rad: 0.0, swing_rad: 0.0 }, height_m)
    }

    #[test]
    fn somebody_who_stands_is_as_tall_as_said_and_touches_the_floor() {
        for height in [1.55, 1.75, 1.9] {
            let parts = standing(height);
            let top = parts.iter().map(|c| c.a.z.max(c.b.z) + c.radius).fold(0.0, f32::max);
            let sole = parts.iter().map(|c| c.a.z.min(c.b.z) - c.radius).fold(9.0, f32::min);
            assert!((f64::from(top) - height).abs() < 0.02 * height, "{top} for {height}");
            assert!(sole.abs() < 0.03, "{sole}");
        }
    }

    #[test]
    fn the_centroid_stays_over_the_feet_while_walking() {
        for n in 0..20 {
            let gait = Gait { x_m: 1.0, y_m: 2.0, heading_rad: 0.7, phase_rad: 0.3 * f64::from(n), swing_rad: 0.42 };
            let c = centroid(&capsules(&gait, 1.8));
            assert!((c.x - 1.0).hypot(c.y - 2.0) < 0.08, "{c:?}");
            assert!(c.z > 0.8 && c.z < 1.1, "{c:?}");
        }
    }
}
