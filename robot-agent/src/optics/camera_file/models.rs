//! The models that `camera.toml` can name, one line each: name, table, camera.

use std::sync::Arc;

use protocol::document::{Document, DocumentError};
use serde::Deserialize;

use super::raw::{MaskTable, MountingTable, Problem, TimingTable};
use crate::optics::{
    Camera, Conic, ConicParameters, Ellipsoidal, EllipsoidalParameters, Fisheye, FisheyeParameters, Hyperboloidal,
    HyperboloidalParameters, Misaligned, Misalignment, Mosaic, MosaicParameters, Pal, PalConicoid, PalConicoidDesign,
    PalDesign, PalOrthographic, PalOrthographicDesign, PalSingleViewpoint, PalSingleViewpointDesign, Paraboloidal,
    ParaboloidalParameters, Pinhole, PinholeParameters, Polynomial, PolynomialParameters, Pyramid, PyramidParameters,
    Spherical, SphericalParameters, UnifiedSphere, UnifiedSphereParameters,
};

macro_rules! models {
    ($($field:ident $name:literal $table:ty => $camera:ty),+ $(,)?) => {
        /// Every value that `model` can have, each also the name of its table.
        pub const MODELS: &[&str] = &[$($name),+];

        /// The file as serde sees it.
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct File {
            model: String,
            pub(super) image_size_px: [u32; 2],
            $(#[serde(rename = $name)] $field: Option<$table>,)+
            misalignment: Option<Misalignment>,
            #[serde(default)]
            pub(super) mounting: MountingTable,
            pub(super) mask: Option<MaskTable>,
            #[serde(default)]
            pub(super) timing: TimingTable,
        }

        impl File {
            /// The camera of the one table that the model names.
            pub(super) fn camera(&self) -> Result<Arc<dyn Camera>, Problem> {
                self.check_tables(&[$(($name, self.$field.is_some())),+])?;
                $(if let Some(table) = &self.$field {
                    return match <$camera>::new(table.clone(), self.image_size_px) {
                        Ok(camera) => misaligned(Arc::new(camera), self.misalignment),
                        Err(error) => Err(Problem::parameter($name, error)),
                    };
                })+
                Err(Problem::new("model", &self.model, MODELS.join(" or ")))
            }
        }
    };
}

models! {
    pal "pal" PalDesign => Pal,
    pal_orthographic "pal-orthographic" PalOrthographicDesign => PalOrthographic,
    pal_single_viewpoint "pal-single-viewpoint" PalSingleViewpointDesign => PalSingleViewpoint,
    pal_conicoid "pal-conicoid" PalConicoidDesign => PalConicoid,
    unified_sphere "unified-sphere" UnifiedSphereParameters => UnifiedSphere,
    polynomial "polynomial" PolynomialParameters => Polynomial,
    hyperboloidal "hyperboloidal" HyperboloidalParameters => Hyperboloidal,
    paraboloidal "paraboloidal" ParaboloidalParameters => Paraboloidal,
    ellipsoidal "ellipsoidal" EllipsoidalParameters => Ellipsoidal,
    spherical "spherical" SphericalParameters => Spherical,
    conic "conic" ConicParameters => Conic,
    pyramid "pyramid" PyramidParameters => Pyramid,
    fisheye "fisheye" FisheyeParameters => Fisheye,
    pinhole "pinhole" PinholeParameters => Pinhole,
    mosaic "mosaic" MosaicParameters => Mosaic,
}

impl File {
    fn check_tables(&self, tables: &[(&str, bool)]) -> Result<(), Problem> {
        for (table, present) in tables {
            if *present != (*table == self.model) {
                let expected = if *present {
                    format!("{table:?}, or the table [{table}] goes")
                } else {
                    format!("another, or the table [{table}] is missing")
                };
                return Err(Problem::new("model", &self.model, expected));
            }
        }
        Ok(())
    }
}

fn misaligned(camera: Arc<dyn Camera>, misalignment: Option<Misalignment>) -> Result<Arc<dyn Camera>, Problem> {
    let Some(misalignment) = misalignment else { return Ok(camera) };
    match Misaligned::new(camera, misalignment) {
        Ok(camera) => Ok(Arc::new(camera)),
        Err(error) => Err(Problem::parameter("misalignment", error)),
    }
}

/// The model's name, before the tables: a table of a misspelt model would only look like an unknown key.
pub(super) fn check_name(document: &Document) -> Result<(), DocumentError> {
    #[derive(Deserialize)]
    struct Model {
        model: String,
    }
    let model = document.parse::<Model>()?.model;
    if MODELS.contains(&model.as_str()) {
        return Ok(());
    }
    Err(document.invalid("model", format!("{model:?}"), format!("not a camera model; models: {}", MODELS.join(", "))))
}
