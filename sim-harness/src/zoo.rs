//! The zoo: the same room through every camera.
//!
//! A [`Specimen`] is a camera twice: as its rays are traced here, surface by surface, and as the `camera.toml` that the
//! agent reads. The two share lengths and no formula.

mod sheet;
mod specimens;

use std::path::Path;
use std::sync::Arc;

use robot_agent::optics::{CameraFile, MountedCamera};
use robot_agent::panorama::{GazeWindow, Lut, PanoramaGeometry};
use serde::{Deserialize, Serialize};

use crate::render::bench::OutwardRay;
use crate::render::rays::Rays;
use crate::render::{Renderer, eyes};
use crate::scenario::Scenario;
use crate::world::World;

pub use specimens::specimens;

/// Height of every camera's origin in the room.
pub const HEIGHT_M: f64 = 0.9;
/// When the room is looked at.
const TIME_S: f64 = 2.0;

/// One camera.
pub struct Specimen {
    /// What it is called on the sheet and in file names.
    pub name: &'static str,
    /// Width and height.
    pub size_px: [u32; 2],
    /// The model's table with its header.
    pub table: String,
    /// Name of the model.
    pub model: &'static str,
    /// The ray of a point of the picture, in the model's frame.
    pub trace: Box<dyn Fn(f64, f64) -> Option<OutwardRay> + Send + Sync>,
}

impl Specimen {
    /// As `camera.toml` of a camera so high above the floor.
    pub fn camera_toml(&self, height_m: f64) -> String {
        let Self { model, size_px: [w, h], table, .. } = self;
        format!(
            "model = \"{model}\"\nimage_size_px = [{w}, {h}]\n[{model}]\n{table}\n[mounting]\nheight_m = {height_m:?}\n"
        )
    }

    /// As the agent has it.
    ///
    /// # Errors
    /// Why it is no camera.
    pub fn agents_camera(&self) -> Result<MountedCamera, ZooError> {
        let file = CameraFile::parse(&self.camera_toml(HEIGHT_M), self.name.as_ref());
        file.and_then(|file| file.mount()).map_err(|e| ZooError(e.to_string()))
    }

    /// Origin (m, from the camera's) and unit direction of what a point of the picture sees; `camera` is the agent's: where that
    /// says that nothing is, the lens' stop is.
    pub fn ray(&self, camera: &MountedCamera, u: f64, v: f64) -> Option<eyes::OutwardRay> {
        let nearest = nalgebra::Vector2::new(u.clamp(0.0, 1e9).round(), v.clamp(0.0, 1e9).round());
        camera.camera().unproject(&nearest)?;
        let ray = (self.trace)(u, v)?;
        Some((ray.origin_mm * 1e-3, ray.direction))
    }

    /// Its picture of the first robot's place in a world, and what the agent unwraps it to: all around, or straight ahead
    /// for cameras that do not see all around.
    ///
    /// # Errors
    /// What cannot be made.
    pub fn pictures(&self, world: &Arc<World>) -> Result<[image::GrayImage; 2], ZooError> {
        let camera = self.agents_camera()?;
        let rays = Rays::of_camera(self.size_px, HEIGHT_M, |u, v| self.ray(&camera, u, v));
        let picture = Renderer::with_rays(world, rays).render(TIME_S);
        let lut = match PanoramaGeometry::for_camera(&camera) {
            Ok(geometry) => Lut::panorama(&camera, &geometry),
            Err(_) => {
                let window = GazeWindow { width: 640, height: 480, hfov_rad: 0.8, pan_rad: 0.0, tilt_rad: 0.0 };
                Lut::gaze(&camera, &window)
            }
        };
        let [w, h] = lut.size_px();
        let mut panorama = image::GrayImage::new(w, h);
        lut.unwarp(&picture.gray, &mut panorama).map_err(|e| ZooError(e.to_string()))?;
        let raw = image::GrayImage::from_raw(picture.width, picture.height, picture.gray)
            .ok_or_else(|| ZooError("a picture of another size".into()))?;
        Ok([raw, panorama])
    }
}

/// A camera of the zoo, written as its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Animal(usize);

impl Animal {
    /// The camera.
    pub fn specimen(self) -> &'static Specimen {
        &specimens()[self.0]
    }
}

impl From<Animal> for String {
    fn from(animal: Animal) -> Self {
        animal.specimen().name.to_owned()
    }
}

impl TryFrom<String> for Animal {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let names: Vec<&'static str> = specimens().iter().map(|s| s.name).collect();
        let found = names.iter().position(|known| *known == name).map(Self);
        found.ok_or_else(|| format!("no camera of the zoo is called `{name}`: there are {}", names.join(", ")))
    }
}

/// What went wrong, in words.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ZooError(String);

/// Renders every specimen into a folder: `{name}.png`, `{name}-panorama.png`, `{name}.toml` and all on `sheet.png`.
/// `progress` is called with the number done.
///
/// # Errors
/// The first camera, picture or file that cannot be made, by name.
pub fn write(
    scenario: &Scenario,
    seed: u64,
    out: &Path,
    progress: impl Fn(usize),
) -> Result<Vec<&'static str>, ZooError> {
    let world = World::new(scenario, seed).map_err(|e| ZooError(e.to_string()))?;
    let world = Arc::new(world);
    let cannot =
        |path: &Path, e: &dyn std::fmt::Display| ZooError(format!("{}: cannot be written: {e}", path.display()));
    std::fs::create_dir_all(out).map_err(|e| cannot(out, &e))?;
    let (mut names, mut rows) = (Vec::new(), Vec::new());
    for (n, specimen) in specimens().iter().enumerate() {
        let [raw, panorama] = specimen.pictures(&world).map_err(|e| ZooError(format!("{}: {e}", specimen.name)))?;
        for (suffix, picture) in [(".png", &raw), ("-panorama.png", &panorama)] {
            let path = out.join(format!("{}{suffix}", specimen.name));
            picture.save(&path).map_err(|e| cannot(&path, &e))?;
        }
        let path = out.join(format!("{}.toml", specimen.name));
        std::fs::write(&path, specimen.camera_toml(HEIGHT_M)).map_err(|e| cannot(&path, &e))?;
        names.push(specimen.name);
        rows.push((specimen.name, raw, panorama));
        progress(n + 1);
    }
    let path = out.join("sheet.png");
    sheet::sheet(&rows).save(&path).map_err(|e| cannot(&path, &e))?;
    Ok(names)
}
