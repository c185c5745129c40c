//! A model's parameters: checked one by one with errors a person can act on, and as one flat list of numbers, which is
//! what a calibration turns.

use nalgebra::Vector2;
use serde::{Deserialize, Deserializer};

use super::is_in_image;

/// A parameter that makes no camera: which one, its value, and what would be right.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value}: {expected}")]
pub struct ParameterError {
    /// Key inside the model's table.
    pub key: &'static str,
    /// The value as given.
    pub value: String,
    /// What would be right.
    pub expected: String,
}

impl ParameterError {
    /// Names a wrong value.
    pub fn new(key: &'static str, value: impl std::fmt::Debug, expected: impl Into<String>) -> Self {
        Self { key, value: format!("{value:?}"), expected: expected.into() }
    }
}

/// One number of a camera model.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its key in the model's table, with the index where that is a list: `centre_px[0]`.
    pub name: String,
    /// Its value, in the unit that the key names.
    pub value: f64,
}

/// What a table of `camera.toml` says about a model: all that its camera is made from, apart from the picture's size.
pub trait Design: Clone + std::fmt::Debug + serde::Serialize + Send + Sync + 'static {
    /// Visits every number that a calibration may turn, always in the same order. Choices (a law's name) and limits
    /// (the elevations that are shown) are none.
    fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64));

    /// The numbers with their names.
    fn parameters(&self) -> Vec<Parameter> {
        let mut list = Vec::new();
        self.clone().visit(&mut |name, value| list.push(Parameter { name: name.to_owned(), value: *value }));
        list
    }

    /// The same with other numbers, in the order of [`Design::parameters`]; missing ones stay as they are.
    fn with_values(&self, values: &[f64]) -> Self {
        let mut design = self.clone();
        let mut values = values.iter();
        design.visit(&mut |_, number| *number = values.next().copied().unwrap_or(*number));
        design
    }

    /// The table as it stands in `camera.toml`.
    #[expect(clippy::expect_used, reason = "structs of numbers and names, each tested")]
    fn table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("a design is a table")
    }
}

/// A field that holds numbers.
pub trait Numbers {
    /// Visits each with its name.
    fn visit(&mut self, name: &str, visitor: &mut dyn FnMut(&str, &mut f64));
}

impl Numbers for f64 {
    fn visit(&mut self, name: &str, visitor: &mut dyn FnMut(&str, &mut f64)) {
        visitor(name, self);
    }
}

impl Numbers for [f64] {
    fn visit(&mut self, name: &str, visitor: &mut dyn FnMut(&str, &mut f64)) {
        for (i, value) in self.iter_mut().enumerate() {
            visitor(&format!("{name}[{i}]"), value);
        }
    }
}

impl<const N: usize> Numbers for [f64; N] {
    fn visit(&mut self, name: &str, visitor: &mut dyn FnMut(&str, &mut f64)) {
        self.as_mut_slice().visit(name, visitor);
    }
}

impl Numbers for Vec<f64> {
    fn visit(&mut self, name: &str, visitor: &mut dyn FnMut(&str, &mut f64)) {
        self.as_mut_slice().visit(name, visitor);
    }
}

/// Implements [`Design`] by the fields to visit, in that order.
macro_rules! design {
    ($design:ty: $($field:ident),+ $(,)?) => {
        impl $crate::optics::parameter::Design for $design {
            fn visit(&mut self, visitor: &mut dyn FnMut(&str, &mut f64)) {
                use $crate::optics::parameter::Numbers;
                $(self.$field.visit(stringify!($field), visitor);)+
            }
        }
    };
}
pub(crate) use design;

/// The methods of [`crate::optics::Camera`] that are the same for every model whose struct is `parameters` and
/// `image_size_px`, made by `new`.
macro_rules! camera_by_design {
    ($model:literal) => {
        fn model(&self) -> &'static str {
            $model
        }

        fn image_size_px(&self) -> [u32; 2] {
            self.image_size_px
        }

        fn parameters(&self) -> Vec<$crate::optics::Parameter> {
            $crate::optics::parameter::Design::parameters(&self.parameters)
        }

        fn with_values(
            &self,
            values: &[f64],
        ) -> Result<std::sync::Arc<dyn $crate::optics::Camera>, $crate::optics::ParameterError> {
            let parameters = $crate::optics::parameter::Design::with_values(&self.parameters, values);
            Ok(std::sync::Arc::new(Self::new(parameters, self.image_size_px)?))
        }

        fn table(&self) -> toml::Table {
            $crate::optics::parameter::Design::table(&self.parameters)
        }
    };
}
pub(crate) use camera_by_design;

/// One number for both axes, or one each.
pub(crate) fn one_or_each<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "one number, or one for each axis")]
    enum OneOrEach {
        One(f64),
        Each([f64; 2]),
    }
    Ok(match OneOrEach::deserialize(deserializer)? {
        OneOrEach::One(f) => [f; 2],
        OneOrEach::Each(f) => f,
    })
}

pub(crate) fn one() -> f64 {
    1.0
}

/// A lens or mirror is between a pea and a bucket: outside, the unit is wrong.
pub(crate) fn check_length_mm(key: &'static str, value: f64) -> Result<(), ParameterError> {
    if value > 0.1 && value < 10_000.0 {
        return Ok(());
    }
    Err(ParameterError::new(key, value, "a length in millimetres between 0.1 and 10000 (is it in metres?)"))
}

pub(crate) fn check_positive_px(key: &'static str, value: f64) -> Result<(), ParameterError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(ParameterError::new(key, value, "a positive number of pixels"))
}

/// The coefficients of a distortion: finite numbers.
pub(crate) fn check_finite(key: &'static str, values: &[f64], names: &str) -> Result<(), ParameterError> {
    if values.iter().all(|k| k.is_finite()) {
        return Ok(());
    }
    Err(ParameterError::new(key, values, format!("{names}, finite numbers")))
}

/// Both focal lengths see less than 170°, which no length in millimetres does.
pub(crate) fn check_focal_lengths(focal_length_px: [f64; 2], image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    let error = |expected: &str| Err(ParameterError::new("focal_length_px", focal_length_px, expected));
    if !focal_length_px.iter().all(|f| *f > 0.0 && f.is_finite()) {
        return error("[fx, fy], both positive, in pixels");
    }
    if focal_length_px.iter().zip(image_size_px).any(|(f, side)| *f < 0.05 * f64::from(side)) {
        return error("[fx, fy] in pixels (these are a twentieth of the picture: are they in millimetres?)");
    }
    Ok(())
}

pub(crate) fn check_centre(centre_px: [f64; 2], image_size_px: [u32; 2]) -> Result<(), ParameterError> {
    if is_in_image(&Vector2::from(centre_px), image_size_px) {
        return Ok(());
    }
    let [w, h] = image_size_px;
    Err(ParameterError::new("centre_px", centre_px, format!("inside the picture of {w}x{h} pixels")))
}

/// Pixels are nearly square.
pub(crate) fn check_aspect(aspect: f64) -> Result<(), ParameterError> {
    if aspect > 0.2 && aspect < 5.0 {
        return Ok(());
    }
    Err(ParameterError::new("aspect", aspect, "between 0.2 and 5, 1 for square pixels"))
}

pub(crate) fn check_elevations([low, high]: [f64; 2]) -> Result<(), ParameterError> {
    let error = |expected: &str| Err(ParameterError::new("elevation_deg", [low, high], expected));
    if ![low, high].iter().all(|end| (-90.0..=90.0).contains(end)) {
        return error("[lowest, highest] in degrees, each between -90 and 90");
    }
    if low >= high {
        return error("[lowest, highest]: they are swapped or equal");
    }
    if high - low < 1.0 {
        return error("[lowest, highest] at least 1 degree apart (are they in radians?)");
    }
    Ok(())
}
