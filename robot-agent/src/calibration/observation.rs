//! What a calibration is made from: points of known shape, seen in pictures from unknown places.

use nalgebra::{Matrix3, Vector2, Vector3};

/// Fewer points of a view determine no pose with anything to spare.
pub const MIN_POINTS: usize = 6;
/// A side view of an object is as good as a line when its second extent is this share of its first.
const MIN_FLATNESS: f64 = 1e-3;

/// One picture of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The picture's name, for messages.
    pub name: String,
    /// Points in the object's frame (metres) and where they were seen (pixels).
    pub points: Vec<(Vector3<f64>, Vector2<f64>)>,
}

/// Everything seen with one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Observations {
    /// Width and height of the pictures.
    pub image_size_px: [u32; 2],
    /// The pictures.
    pub views: Vec<View>,
}

/// Why observations cannot calibrate anything.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ObservationError {
    /// Nothing there.
    #[error("no views: a calibration needs pictures of a board in different poses")]
    NoViews,
    /// A view with too few points.
    #[error("view {view:?} has {points} points; at least {MIN_POINTS} are needed")]
    TooFewPoints {
        /// Its name.
        view: String,
        /// How many it has.
        points: usize,
    },
    /// A view whose points lie on one line.
    #[error(
        "view {view:?}: its {what} lie on one line; they say nothing about the board's pose (wrong board size or order?)"
    )]
    Collinear {
        /// Its name.
        view: String,
        /// Object points or image points.
        what: &'static str,
    },
    /// Two points of a view at one place.
    #[error("view {view:?}: points {first} and {second} are both at [{u:.2}, {v:.2}] px")]
    Coincident {
        /// Its name.
        view: String,
        /// Index from 0.
        first: usize,
        /// Index from 0.
        second: usize,
        /// Column, px.
        u: f64,
        /// Row, px.
        v: f64,
    },
    /// A number that is none, or a pixel off the picture.
    #[error("view {view:?}, point {index}: [{u}, {v}] px must be finite and on the picture of {w}x{h} pixels")]
    OffPicture {
        /// Its name.
        view: String,
        /// Index from 0.
        index: usize,
        /// Column, px.
        u: f64,
        /// Row, px.
        v: f64,
        /// Width, px.
        w: u32,
        /// Height, px.
        h: u32,
    },
    /// An object point that is not finite.
    #[error("view {view:?}, point {index}: the object point must be three finite numbers in metres")]
    NotFinite {
        /// Its name.
        view: String,
        /// Index from 0.
        index: usize,
    },
}

impl Observations {
    /// Checks every view.
    ///
    /// # Errors
    /// The first view that no pose can be found from.
    pub fn new(image_size_px: [u32; 2], views: Vec<View>) -> Result<Self, ObservationError> {
        if views.is_empty() {
            return Err(ObservationError::NoViews);
        }
        views.iter().try_for_each(|view| view.check(image_size_px))?;
        Ok(Self { image_size_px, views })
    }

    /// Number of points in all views.
    pub fn points(&self) -> usize {
        self.views.iter().map(|view| view.points.len()).sum()
    }

    /// The views with these indices.
    pub fn subset(&self, indices: &[usize]) -> Self {
        let views = indices.iter().map(|i| self.views[*i].clone()).collect();
        Self { image_size_px: self.image_size_px, views }
    }
}

impl View {
    fn check(&self, image_size_px: [u32; 2]) -> Result<(), ObservationError> {
        let view = || self.name.clone();
        if self.points.len() < MIN_POINTS {
            return Err(ObservationError::TooFewPoints { view: view(), points: self.points.len() });
        }
        let [w, h] = image_size_px;
        for (index, (object, pixel)) in self.points.iter().enumerate() {
            if !crate::optics::is_in_image(pixel, image_size_px) {
                return Err(ObservationError::OffPicture { view: view(), index, u: pixel.x, v: pixel.y, w, h });
            }
            if !object.iter().all(|x| x.is_finite()) {
                return Err(ObservationError::NotFinite { view: view(), index });
            }
            let twin = self.points[..index].iter().position(|(_, other)| (other - pixel).norm() < 1e-6);
            if let Some(first) = twin {
                return Err(ObservationError::Coincident {
                    view: view(),
                    first,
                    second: index,
                    u: pixel.x,
                    v: pixel.y,
                });
            }
        }
        let objects: Vec<Vector3<f64>> = self.points.iter().map(|(object, _)| *object).collect();
        let images: Vec<Vector3<f64>> = self.points.iter().map(|(_, pixel)| pixel.push(0.0)).collect();
        for (what, points) in [("object points", &objects), ("image points", &images)] {
            let [first, second, _] = extents(points);
            if second < MIN_FLATNESS * first {
                return Err(ObservationError::Collinear { view: view(), what });
            }
        }
        Ok(())
    }

    /// Whether the object's points lie in its plane z = 0.
    pub fn is_planar(&self) -> bool {
        self.points.iter().all(|(object, _)| object.z == 0.0)
    }
}

/// Standard deviations along the principal axes, largest first.
fn extents(points: &[Vector3<f64>]) -> [f64; 3] {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut values: [f64; 3] = scatter.symmetric_eigenvalues().map(|x| (x.max(0.0) / n).sqrt()).into();
    values.sort_by(|a, b| b.total_cmp(a));
    values
}
