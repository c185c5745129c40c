//! Fisheye lenses by their law r(θ), θ from the optical axis z (`model = "fisheye"`).
//!
//! | law | r(θ) | up to |
//! |---|---|---|
//! | equidistant | f θ | π |
//! | stereographic | 2f tan(θ/2) | π, exclusive |
//! | equisolid | 2f sin(θ/2) | π* |
//! | orthographic | f sin θ | π/2* |
//! | kannala-brandt | f (θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹) | where it turns back*, at most π |
//!
//! \* less a thousandth of a radian: where r(θ) turns back, a pixel says nothing about its angle.
//!
//! Real fisheyes have a single viewpoint only approximately (the entrance pupil moves). Source: `MATHS.md` §1.1 (7),
//! Kannala and Brandt 2006 as OpenCV's `fisheye` and Kalibr's `equi` write it.

use std::f64::consts::{FRAC_PI_2, PI};

use serde::{Deserialize, Serialize};

use super::ParameterError;
use super::axial::{Axial, AxialDesign, AxialOptics, AxialRay, AxialSlope, ImagePlane};
use super::parameter::{Design, Numbers, check_finite, check_focal_lengths, one_or_each};
use super::root::root;

/// A field of view ends this much before the radius turns back.
const TURN_MARGIN_RAD: f64 = 1e-3;

/// How a fisheye's image radius grows with the angle off its axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FisheyeLaw {
    /// f θ.
    Equidistant,
    /// 2f tan(θ/2).
    Stereographic,
    /// 2f sin(θ/2).
    Equisolid,
    /// f sin θ.
    Orthographic,
    /// f (θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹).
    KannalaBrandt,
}

/// The parameters of `[fisheye]` in `camera.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FisheyeParameters {
    /// r(θ).
    pub law: FisheyeLaw,
    /// (fx, fy), px.
    #[serde(deserialize_with = "one_or_each")]
    pub focal_length_px: [f64; 2],
    /// (cx, cy), px.
    pub centre_px: [f64; 2],
    /// k₁ … k₄ of `kannala-brandt`; 0 for the other laws.
    #[serde(default)]
    pub k: [f64; 4],
}

impl Design for FisheyeParameters {
    fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64)) {
        self.focal_length_px.visit("focal_length_px", visitor);
        self.centre_px.visit("centre_px", visitor);
        if self.law == FisheyeLaw::KannalaBrandt {
            self.k.visit("k", visitor);
        }
    }
}

/// A fisheye camera, validated.
pub type Fisheye = Axial<FisheyeParameters>;

/// A law with its focal length along v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FisheyeOptics {
    law: FisheyeLaw,
    focal_length_px: f64,
    k: [f64; 4],
    /// The largest θ with an image.
    limit_rad: f64,
}

impl AxialDesign for FisheyeParameters {
    const MODEL: &'static str = "fisheye";
    type Optics = FisheyeOptics;

    fn optics(&self, image_size_px: [u32; 2]) -> Result<FisheyeOptics, ParameterError> {
        check_focal_lengths(self.focal_length_px, image_size_px)?;
        check_finite("k", &self.k, "[k1, k2, k3, k4]")?;
        let limit_rad = match self.law {
            FisheyeLaw::Equidistant | FisheyeLaw::Stereographic => PI,
            FisheyeLaw::Equisolid => PI - TURN_MARGIN_RAD,
            FisheyeLaw::Orthographic => FRAC_PI_2 - TURN_MARGIN_RAD,
            FisheyeLaw::KannalaBrandt => turning_angle(self.k) - TURN_MARGIN_RAD,
        };
        if self.law != FisheyeLaw::KannalaBrandt && self.k != [0.0; 4] {
            return Err(ParameterError::new("k", self.k, "left out: only law = \"kannala-brandt\" has coefficients"));
        }
        if limit_rad < 0.1 {
            let turn = limit_rad.to_degrees();
            let expected =
                format!("coefficients of a growing radius: this one turns back {turn:.1} degrees off the axis");
            return Err(ParameterError::new("k", self.k, expected));
        }
        Ok(FisheyeOptics { law: self.law, focal_length_px: self.focal_length_px[1], k: self.k, limit_rad })
    }

    fn image_plane(&self) -> ImagePlane {
        let [fx, fy] = self.focal_length_px;
        ImagePlane { centre_px: self.centre_px, aspect: fx / fy, upside_down: false }
    }

    fn elevation_deg(&self) -> Option<[f64; 2]> {
        None
    }
}

impl AxialOptics for FisheyeOptics {
    fn ray_of_radius(&self, radius_px: f64) -> Option<AxialRay> {
        let x = radius_px / self.focal_length_px;
        let zenith_rad = match self.law {
            FisheyeLaw::Equidistant => x,
            FisheyeLaw::Stereographic => 2.0 * (0.5 * x).atan(),
            FisheyeLaw::Equisolid => 2.0 * (0.5 * x).asin(),
            FisheyeLaw::Orthographic => x.asin(),
            FisheyeLaw::KannalaBrandt => self.inverse(x)?,
        };
        (zenith_rad <= self.limit_rad).then_some(AxialRay { origin_mm: [0.0; 2], zenith_rad })
    }

    fn slope_of_radius(&self, radius_px: f64) -> Option<AxialSlope> {
        let x = radius_px / self.focal_length_px;
        let by_x = match self.law {
            FisheyeLaw::Equidistant => 1.0,
            FisheyeLaw::Stereographic => (1.0 + 0.25 * x * x).recip(),
            FisheyeLaw::Equisolid => (1.0 - 0.25 * x * x).sqrt().recip(),
            FisheyeLaw::Orthographic => (1.0 - x * x).sqrt().recip(),
            FisheyeLaw::KannalaBrandt => kannala_brandt(self.k, self.inverse(x)?).1.recip(),
        };
        Some(AxialSlope { origin_mm: [0.0; 2], zenith_rad: by_x / self.focal_length_px })
    }

    fn focal_length_px(&self) -> f64 {
        self.focal_length_px
    }

    fn radius_of_zenith(&self, theta: f64) -> Option<f64> {
        let x = match self.law {
            FisheyeLaw::Equidistant => theta,
            FisheyeLaw::Stereographic => 2.0 * (0.5 * theta).tan(),
            FisheyeLaw::Equisolid => 2.0 * (0.5 * theta).sin(),
            FisheyeLaw::Orthographic => theta.sin(),
            FisheyeLaw::KannalaBrandt => kannala_brandt(self.k, theta).0,
        };
        (theta <= self.limit_rad).then_some(x * self.focal_length_px)
    }
}

impl FisheyeOptics {
    /// θ with θ + k₁θ³ + … = x; up to the limit the polynomial rises.
    fn inverse(&self, x: f64) -> Option<f64> {
        (x <= kannala_brandt(self.k, self.limit_rad).0).then_some(())?;
        root(0.0, self.limit_rad, x, |theta| {
            let (value, slope) = kannala_brandt(self.k, theta);
            (value - x, slope)
        })
    }
}

/// θ + k₁θ³ + k₂θ⁵ + k₃θ⁷ + k₄θ⁹ and its derivative.
fn kannala_brandt([k1, k2, k3, k4]: [f64; 4], theta: f64) -> (f64, f64) {
    let s = theta * theta;
    let value = theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))));
    let slope = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)));
    (value, slope)
}

/// The least θ where the law stops rising, at most π.
fn turning_angle(k: [f64; 4]) -> f64 {
    const STEPS: u32 = 1000;
    let slope = |theta: f64| kannala_brandt(k, theta).1;
    for i in 1..=STEPS {
        let mut high = PI * f64::from(i) / f64::from(STEPS);
        if slope(high) <= 0.0 {
            let mut low = PI * f64::from(i - 1) / f64::from(STEPS);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if slope(middle) > 0.0 { low = middle } else { high = middle }
            }
            return low;
        }
    }
    PI
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::optics::Camera;
    use crate::optics::laws::{camera_laws, golden};

    fn camera(law: FisheyeLaw, k: [f64; 4]) -> Fisheye {
        let parameters = FisheyeParameters { law, focal_length_px: [200.0, 200.0], centre_px: [383.5, 287.5], k };
        Fisheye::new(parameters, [768, 576]).unwrap()
    }

    const K: [f64; 4] = [0.02, -0.005, 0.001, -0.0001];

    camera_laws!(equidistant, camera(FisheyeLaw::Equidistant, [0.0; 4]));
    camera_laws!(stereographic, camera(FisheyeLaw::Stereographic, [0.0; 4]));
    camera_laws!(equisolid, camera(FisheyeLaw::Equisolid, [0.0; 4]));
    camera_laws!(orthographic, camera(FisheyeLaw::Orthographic, [0.0; 4]));
    camera_laws!(kannala_brandt_law, camera(FisheyeLaw::KannalaBrandt, K));

    #[test]
    fn radii_are_golden() {
        let (inputs, outputs, tol) = golden("fisheye");
        for (name, law) in [
            ("equidistant", FisheyeLaw::Equidistant),
            ("stereographic", FisheyeLaw::Stereographic),
            ("equisolid", FisheyeLaw::Equisolid),
            ("orthographic", FisheyeLaw::Orthographic),
        ] {
            check(&camera(law, [0.0; 4]), &inputs["theta"], &outputs[name], tol);
        }
        let (inputs, outputs, tol) = golden("fisheye.kb");
        check(&camera(FisheyeLaw::KannalaBrandt, K), &inputs["theta"], &outputs, tol);
    }

    fn check(camera: &Fisheye, theta: &serde_json::Value, radius: &serde_json::Value, tol: f64) {
        for (theta, radius) in theta.as_array().unwrap().iter().zip(radius.as_array().unwrap()) {
            let (sin, cos) = theta.as_f64().unwrap().sin_cos();
            let pixel = camera.image_of_direction(&Vector3::new(sin, 0.0, cos)).unwrap();
            crate::optics::laws::assert_rel(pixel.x - 383.5, radius, tol);
        }
    }

    #[test]
    fn coefficients_that_turn_back_at_once_or_belong_to_no_law_are_named() {
        let parameters = |law, k| FisheyeParameters { law, focal_length_px: [200.0; 2], centre_px: [300.0; 2], k };
        let error = |p| Fisheye::new(p, [768, 576]).unwrap_err().to_string();
        let turning = error(parameters(FisheyeLaw::KannalaBrandt, [-100.0, 0.0, 0.0, 0.0]));
        assert!(turning.contains("turns back 3.3 degrees"), "{turning}");
        assert!(error(parameters(FisheyeLaw::Equisolid, K)).contains("kannala-brandt"));
        let millimetres =
            FisheyeParameters { focal_length_px: [2.7; 2], ..parameters(FisheyeLaw::Equidistant, [0.0; 4]) };
        assert!(error(millimetres).contains("millimetres"));
    }
}
