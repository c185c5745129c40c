//! The camera of a scenario: the lengths of a PAL's glass, as a calibration file lists them.

use protocol::id::RobotId;
use serde::{Deserialize, Serialize};

use super::OtherCamera;

/// A PAL of two mirrors and a refracting ellipsoid, and the sensor behind it. The defaults are the project's reference
/// design: 768×576, −15° … +20°.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSpec {
    /// Width, height.
    pub image_size_px: [u32; 2],
    /// Ring mirror: half of the long axis.
    pub ellipsoid_a_mm: f64,
    /// Ring mirror: half of the distance between its foci.
    pub ellipsoid_c_mm: f64,
    /// Second mirror: half of the distance between its vertices.
    pub hyperboloid_a_mm: f64,
    /// Second mirror: half of the distance between its foci.
    pub hyperboloid_c_mm: f64,
    /// Pinhole to image plane.
    pub focal_length_px: f64,
    /// Outer surface: half of the long axis.
    pub refraction_a_mm: f64,
    /// Outer surface.
    pub refraction_eccentricity: f64,
    /// Glass against air.
    pub refractive_index: f64,
    /// Where the axis meets the picture.
    pub centre_px: [f64; 2],
    /// Lowest and highest direction that the design is for.
    pub elevation_deg: [f64; 2],
    /// Of the glass' focus V above the floor.
    pub height_m: f64,
    /// Standard deviation of the sensor noise, grey levels.
    pub noise_gray: f64,
    /// Standard deviation of the lens' blur.
    pub blur_px: f64,
    /// Robots whose camera stands askew on its body.
    pub tilts: Vec<TiltSpec>,
    /// Robots that have no PAL.
    pub others: Vec<OtherCamera>,
}

/// A camera that stands askew on an upright robot, turned about its glass' focus V.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TiltSpec {
    /// Whose, e.g. "r1".
    pub robot: RobotId,
    /// Roll (lowers the right side), then pitch (lowers the nose). −10 … 10 each.
    pub tilt_deg: [f64; 2],
    /// Whether the robot's camera file says so. If not, it is for `robot-agent calibrate mounting` to find out.
    #[serde(default = "yes")]
    pub known: bool,
}

fn yes() -> bool {
    true
}

impl Default for CameraSpec {
    fn default() -> Self {
        Self {
            image_size_px: [768, 576],
            ellipsoid_a_mm: 23.809_523_809_5,
            ellipsoid_c_mm: 9.523_809_523_81,
            hyperboloid_a_mm: 6.476_190_476_19,
            hyperboloid_c_mm: 16.523_809_523_8,
            focal_length_px: 751.849_545_07,
            refraction_a_mm: 31.25,
            refraction_eccentricity: 0.6,
            refractive_index: 1.5168,
            centre_px: [383.5, 287.5],
            elevation_deg: [-15.0, 20.0],
            height_m: 0.6,
            noise_gray: 2.0,
            blur_px: 0.8,
            tilts: Vec::new(),
            others: Vec::new(),
        }
    }
}

impl CameraSpec {
    /// The same with a quarter of the pixels.
    pub fn halved(&self) -> Self {
        let [w, h] = self.image_size_px;
        Self {
            image_size_px: [w / 2, h / 2],
            focal_length_px: self.focal_length_px / 2.0,
            centre_px: [w, h].map(|side| (f64::from(side / 2) - 1.0) / 2.0),
            ..self.clone()
        }
    }

    /// The true tilt (roll, pitch) of a robot's camera, degrees.
    pub fn tilt_deg(&self, robot: &RobotId) -> [f64; 2] {
        self.tilts.iter().find(|t| t.robot == *robot).map_or([0.0; 2], |t| t.tilt_deg)
    }

    /// As a robot's `camera.toml`, whichever camera it has: the truth but for a tilt that nobody knows of.
    pub fn toml_of(&self, robot: &RobotId) -> String {
        if let Some(other) = self.other(robot) {
            return other.toml(self.height_m);
        }
        let mut text = self.toml();
        if let Some(TiltSpec { tilt_deg: [roll, pitch], .. }) = self.tilts.iter().find(|t| t.robot == *robot && t.known)
        {
            text.push_str(&format!("tilt_deg = [{roll:?}, {pitch:?}]\n"));
        }
        text
    }

    /// As the `camera.toml` of a camera that stands upright.
    pub fn toml(&self) -> String {
        let Self { image_size_px: [w, h], centre_px: [u, v], elevation_deg: [low, high], .. } = self;
        format!(
            "model = \"pal\"\nimage_size_px = [{w}, {h}]\n[pal]\nellipsoid_a_mm = {:?}\nellipsoid_c_mm = {:?}\n\
             hyperboloid_a_mm = {:?}\nhyperboloid_c_mm = {:?}\nfocal_length_px = {:?}\nrefraction_a_mm = {:?}\n\
             refraction_eccentricity = {:?}\nrefractive_index = {:?}\ncentre_px = [{u:?}, {v:?}]\naspect = 1.0\n\
             elevation_deg = [{low:?}, {high:?}]\n[mounting]\nheight_m = {:?}\n",
            self.ellipsoid_a_mm,
            self.ellipsoid_c_mm,
            self.hyperboloid_a_mm,
            self.hyperboloid_c_mm,
            self.focal_length_px,
            self.refraction_a_mm,
            self.refraction_eccentricity,
            self.refractive_index,
            self.height_m,
        )
    }
}
