//! From places in the tested picture to angles in the robot's body frame.

use crate::optics::MountedCamera;
use crate::panorama::PanoramaGeometry;

/// What the pixels of the tested picture are in angles, and how high and how level the camera is.
#[derive(Debug, Clone)]
pub struct View {
    picture: Picture,
    /// Height of the viewpoint above the floor with its sigma (metres); `None`: no range may be built on it.
    pub height_m: Option<(f64, f64)>,
    /// Standard deviation of the horizon's elevation (radians): tilt that is not known.
    pub tilt_sigma_rad: f64,
    /// A camera whose rows or columns are read one after the other.
    rolling: Option<MountedCamera>,
}

#[derive(Debug, Clone)]
enum Picture {
    Panorama(PanoramaGeometry),
    Image(MountedCamera),
}

impl View {
    /// A panorama made from a camera.
    pub fn panorama(geometry: PanoramaGeometry, camera: &MountedCamera) -> Self {
        Self::new(Picture::Panorama(geometry), camera)
    }

    /// The camera's own picture (pinhole).
    pub fn image(camera: MountedCamera) -> Self {
        let mounted = camera.clone();
        Self::new(Picture::Image(camera), &mounted)
    }

    /// A panorama of which only the columns mean angles: nothing is known of the camera's height, tilt and rows.
    pub fn uncalibrated(geometry: PanoramaGeometry) -> Self {
        Self { picture: Picture::Panorama(geometry), height_m: None, tilt_sigma_rad: 0.0, rolling: None }
    }

    fn new(picture: Picture, camera: &MountedCamera) -> Self {
        let mounting = camera.mounting();
        let height_sigma_m = mounting.sigma.position_m.z;
        let [roll, pitch, _] = mounting.sigma.rotation_rpy_rad;
        Self {
            picture,
            height_m: mounting.height_m().map(|_| (camera.viewpoint_body_m().z, height_sigma_m)),
            tilt_sigma_rad: roll.hypot(pitch) / std::f64::consts::SQRT_2,
            rolling: is_rolling(camera).then(|| camera.clone()),
        }
    }

    /// Bearing (−π, π] and elevation of a place (pixels, centres at integers; columns may run over the seam); `None`
    /// where the camera sees nothing.
    pub fn angles_rad(&self, column: f64, row: f64) -> Option<(f64, f64)> {
        match &self.picture {
            Picture::Panorama(g) => Some((g.bearing_of_column(column), g.elevation_of_row(row))),
            Picture::Image(camera) => camera.bearing_elevation_rad(&nalgebra::Vector2::new(column, row)),
        }
    }

    /// How much later than the frame's capture time a place was seen, seconds: a camera that reads its rows or columns one after
    /// the other sees what is on one side of the robot before what is on the other.
    pub fn delay_s(&self, column: f64, row: f64) -> f64 {
        if !self.is_rolling() {
            return 0.0;
        }
        self.angles_rad(column, row).map_or(0.0, |(bearing, elevation)| self.delay_at_s(bearing, elevation))
    }

    /// As [`View::delay_s`], of what is in a direction, radians.
    pub fn delay_at_s(&self, bearing: f64, elevation: f64) -> f64 {
        let Some(camera) = &self.rolling else { return 0.0 };
        // Any distance will do: a row is some tens of microseconds.
        const AWAY_M: f64 = 5.0;
        let point = camera.viewpoint_body_m() + AWAY_M * crate::optics::direction(bearing, elevation);
        camera.project_body(&point).map_or(0.0, |at| camera.seen_after_s(&at))
    }

    /// Row of an elevation in a panorama; may lie outside of it. `None` in an image.
    pub fn row_of_elevation(&self, elevation_rad: f64) -> Option<f64> {
        match &self.picture {
            Picture::Panorama(g) => Some(g.row_of_elevation(elevation_rad)),
            Picture::Image(_) => None,
        }
    }

    /// Column of a bearing in a panorama; `None` in an image.
    pub fn column_of_bearing(&self, bearing_rad: f64) -> Option<f64> {
        match &self.picture {
            Picture::Panorama(g) => Some(g.column_of_bearing(bearing_rad)),
            Picture::Image(_) => None,
        }
    }

    /// Angle of one column and one row there, radians.
    pub fn steps_rad(&self, column: f64, row: f64) -> [f64; 2] {
        match &self.picture {
            Picture::Panorama(g) => [g.bearing_step_rad(), g.elevation_step_rad(row)],
            Picture::Image(_) => {
                let at = |c: f64, r: f64| self.angles_rad(c, r);
                match (at(column - 0.5, row), at(column + 0.5, row), at(column, row - 0.5), at(column, row + 0.5)) {
                    (Some(l), Some(r), Some(t), Some(b)) => {
                        [protocol::angle::difference(l.0, r.0).abs(), (t.1 - b.1).abs()].map(|s| s.max(1e-6))
                    }
                    // At the border of the picture any finite scale will do: ends there are cut.
                    _ => [2e-3, 2e-3],
                }
            }
        }
    }

    /// The first row below the horizon if everybody who stands on the floor reaches above it: for a panorama of a camera below
    /// people's hips. For [`crate::motion::MotionSettings::upright_row`].
    pub fn upright_row(&self) -> Option<usize> {
        const HIPS_M: f64 = 0.85;
        let Picture::Panorama(g) = &self.picture else { return None };
        let row = g.row_of_elevation(0.0).ceil();
        let inside = row > 0.0 && row < f64::from(g.height());
        self.height_m.filter(|(h, _)| *h < HIPS_M && inside).map(|_| row as usize)
    }

    /// Whether not all of a picture is seen at once.
    pub fn is_rolling(&self) -> bool {
        self.rolling.is_some()
    }

    /// Whether this is a ring.
    pub fn is_panoramic(&self) -> bool {
        matches!(self.picture, Picture::Panorama(_))
    }
}

/// Whether not all of a picture is seen at once.
fn is_rolling(camera: &MountedCamera) -> bool {
    let [w, h] = camera.image_size_px().map(f64::from);
    let seen = |u: f64, v: f64| camera.seen_after_s(&nalgebra::Vector2::new(u, v)) != 0.0;
    seen(0.0, 0.0) || seen(w - 1.0, h - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Timing;

    #[test]
    fn rows_of_a_rolling_shutter_are_late_by_their_place_in_the_picture() {
        let camera = MountedCamera::reference(0.6).with_timing(Timing { readout_s: 0.024, ..Timing::default() });
        let geometry = PanoramaGeometry::for_camera(&camera).unwrap();
        let view = View::panorama(geometry, &camera);
        let delay = |bearing_deg: f64| {
            let column = view.column_of_bearing(bearing_deg.to_radians()).unwrap();
            view.delay_s(column, view.row_of_elevation(0.0).unwrap())
        };
        // The horizon is a circle round the middle: ahead and behind lie in its row, left of the robot is below it.
        assert!(delay(0.0).abs() < 1e-4 && delay(179.9).abs() < 1e-4);
        let radius =
            camera.project_body(&(camera.viewpoint_body_m() + nalgebra::Vector3::new(5.0, 0.0, 0.0))).unwrap().x
                - 383.5;
        assert!((delay(90.0) - 0.024 * radius / 576.0).abs() < 1e-4, "{}", delay(90.0));
        assert!((delay(-90.0) + delay(90.0)).abs() < 1e-4);
    }
}
