//! What people wear: reflectances and patterns of shirt, trousers, shoes, skin and hair.

use rand::{Rng, RngExt};

use super::person::Cover;
use super::texture::cloud;
use super::vector::V3;

/// Clothes and skin of one person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clothes {
    /// Mean reflectance of the shirt.
    pub shirt: f32,
    /// Mean reflectance of the trousers.
    pub trousers: f32,
    /// Of the shoes.
    pub shoes: f32,
    /// Of face and hands.
    pub skin: f32,
    /// Of the hair.
    pub hair: f32,
    /// Relative strength of the pattern.
    pub contrast: f32,
    /// Stripes a metre, 0 for a mottled cloth.
    pub stripes: f32,
    /// Of the pattern.
    pub seed: u32,
}

impl Clothes {
    /// Any clothes.
    pub fn random(rng: &mut impl Rng) -> Self {
        Self {
            shirt: rng.random_range(0.15..0.75),
            trousers: rng.random_range(0.08..0.35),
            shoes: rng.random_range(0.05..0.25),
            skin: rng.random_range(0.25..0.55),
            hair: rng.random_range(0.05..0.25),
            contrast: rng.random_range(0.25..0.6),
            stripes: if rng.random_bool(0.5) { rng.random_range(7.0..14.0) } else { 0.0 },
            seed: rng.random(),
        }
    }

    /// Clothes of one colour all over, faintly mottled, nothing bright or dark about them.
    pub fn plain(self, reflectance: f32) -> Self {
        Self {
            shirt: reflectance,
            trousers: reflectance,
            shoes: reflectance,
            skin: reflectance,
            hair: reflectance * 0.9,
            contrast: 0.08,
            stripes: 0.0,
            seed: self.seed,
        }
    }

    /// Reflectance on part number `part` with this cover: `along` in metres along the part, `normal` in the body's axes.
    #[inline]
    pub fn reflectance(&self, part: usize, cover: Cover, along: f32, normal: V3) -> f32 {
        let mottle = |scale: f32| {
            cloud(self.seed ^ part as u32, along * scale + normal.z * 1.3, normal.x * 1.7 + normal.y * 2.9)
        };
        let r = match cover {
            Cover::Skin if part == 0 && (normal.z > 0.35 || normal.x < -0.1) => self.hair,
            Cover::Skin => self.skin,
            Cover::Shoes => self.shoes,
            Cover::Trousers => self.trousers * (1.0 + 0.5 * self.contrast * mottle(9.0)),
            Cover::Shirt => {
                let stripes = if self.stripes > 0.0 {
                    (along * self.stripes * std::f32::consts::TAU).sin().clamp(-0.6, 0.6)
                } else {
                    0.0
                };
                self.shirt * (1.0 + self.contrast * (stripes + 0.7 * mottle(11.0)))
            }
        };
        r.clamp(0.02, 0.95)
    }
}
