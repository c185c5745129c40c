//! Pictures for people: what the robot sees, who is there, and where they went.
//!
//! A [`Gallery`] keeps the little that pictures of the past need (the last 32 places of each track, cut-outs for the
//! synopsis); everything else is drawn on demand from the frame's state, enlarged so that labels have room.

mod animation;
mod canvas;
mod gaze;
mod synopsis;

use std::collections::VecDeque;
use std::io::Cursor;

use image::{ImageEncoder, RgbImage};
use protocol::message::{ObjectClass, TrackState};

pub use animation::Animation;
pub use synopsis::{MAX_CUTOUTS, is_pasted};

use crate::motion::{MotionStage, Patch, Raster};
use crate::tracking::{TrackView, View};
use canvas::{Canvas, DIM, WHITE, colour};
use synopsis::{Cutout, Synopsis};

/// Frames of the track image.
pub const TRACK_FRAMES: usize = 32;

/// A picture that could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// From the encoder.
    #[error("the picture could not be encoded: {0}")]
    Encode(#[from] image::ImageError),
    /// From the encoder of animations.
    #[error("the animation could not be encoded: {0}")]
    Animate(#[from] png::EncodingError),
}

/// As PNG.
///
/// # Errors
/// What the encoder says.
pub fn encode_png(picture: &RgbImage) -> Result<Vec<u8>, PictureError> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// As JPEG, quality 1 … 100.
///
/// # Errors
/// What the encoder says.
pub fn encode_jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>, PictureError> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100));
    encoder.write_image(picture, picture.width(), picture.height(), image::ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// Draws the pictures of one robot.
#[derive(Debug)]
pub struct Gallery {
    raster: Raster,
    history: VecDeque<Vec<TrackView>>,
    synopsis: Synopsis,
    /// The newest cut-out of each track of the last frame.
    portraits: Vec<Cutout>,
    windows: gaze::Windows,
}

impl Gallery {
    /// Empty.
    pub fn new(raster: Raster) -> Self {
        Self {
            raster,
            history: VecDeque::new(),
            synopsis: Synopsis::default(),
            portraits: Vec::new(),
            windows: gaze::Windows::default(),
        }
    }

    /// Remember a frame. Cheap; may be left out when time is short.
    pub fn record(&mut self, motion: &MotionStage, tracks: &[TrackView]) {
        let scene = motion.scene();
        let visible: Vec<&TrackView> = tracks.iter().filter(|t| t.state == TrackState::Visible).collect();
        self.synopsis.record(&scene, &visible);
        for track in visible {
            let patch = Patch { arc: track.arc, rows: track.rows };
            match self.portraits.iter_mut().find(|p| p.track == track.id) {
                Some(portrait) => portrait.take(&scene, patch),
                None => self.portraits.push(Cutout::of(&scene, track.id, patch)),
            }
        }
        self.windows.follow(tracks);
        if self.history.len() == TRACK_FRAMES {
            self.history.pop_front();
        }
        self.history.push_back(tracks.to_vec());
        self.portraits.retain(|p| self.history.iter().flatten().any(|t| t.id == p.track));
    }

    /// One frame of an animation: the picture with boxes and numbers, in a panorama also a row of gaze windows. Always of one size.
    pub fn frame(&self, picture: &[u8], tracks: &[TrackView], view: &View) -> RgbImage {
        const LEAST_COLUMNS: usize = 900;
        let Raster { width, height, wraps } = self.raster;
        let factor = LEAST_COLUMNS.div_ceil(width.max(1)).clamp(1, 3);
        let mut canvas = Canvas::enlarged(picture, width, height, factor as u32);
        let period = wraps.then(|| canvas.at(width as f64));
        for track in tracks.iter().filter(|t| t.state != TrackState::Hidden) {
            let (left, top) = (canvas.at(track.arc.start as f64), canvas.at(track.rows[0] as f64));
            let (w, h) = (canvas.at(track.arc.width as f64), canvas.at((track.rows[1] - track.rows[0] + 1) as f64));
            canvas.frame(left, top, w, h, colour(track.id.0), period);
            canvas.label(canvas.at(track.axis_column) - 8.0, top, &track.id.to_string(), colour(track.id.0));
        }
        if !view.is_panoramic() {
            return canvas.image;
        }
        let gaze = self.quick_gaze(picture, tracks, view);
        let mut both = RgbImage::new(canvas.image.width().max(gaze.width()), canvas.image.height() + gaze.height());
        image::imageops::replace(&mut both, &canvas.image, 0, 0);
        image::imageops::replace(&mut both, &gaze, 0, i64::from(canvas.image.height()));
        both
    }

    /// The picture with boxes, identities, bearings and ranges, and a scale of bearings below.
    pub fn panorama(&self, picture: &[u8], tracks: &[TrackView], view: &View) -> RgbImage {
        let mut canvas = Canvas::new(picture, self.raster.width, self.raster.height);
        let period = self.raster.wraps.then(|| canvas.at(self.raster.width as f64));
        if view.is_panoramic() {
            draw_bearing_scale(&mut canvas, &self.raster, view);
        }
        for track in tracks {
            let paint = colour(track.id.0);
            let (left, top) = (canvas.at(track.arc.start as f64), canvas.at(track.rows[0] as f64));
            let (width, height) =
                (canvas.at(track.arc.width as f64), canvas.at((track.rows[1] - track.rows[0] + 1) as f64));
            if track.state != TrackState::Hidden {
                canvas.frame(left, top, width, height, paint, period);
            }
            let axis = canvas.at(track.axis_column + 0.5);
            let dashes = if track.state == TrackState::Visible { 1 } else { 3 };
            for k in (0..(height as usize)).step_by(3 * dashes) {
                canvas.dot(axis, top + k as f32, 1.0, paint, true);
            }
        }
        // Labels last and beside each other: nothing may cover them.
        let mut taken: Vec<(f32, f32)> = Vec::new();
        for track in tracks {
            let text = describe(track);
            let width = canvas.label_width(&text);
            let left =
                (canvas.at(track.axis_column) - width / 2.0).clamp(0.0, (canvas.image.width() as f32 - width).max(0.0));
            let level = (0..6)
                .find(|&level| {
                    let y = level as f32 * 22.0;
                    !taken.iter().any(|&(x, ty)| ty == y && (x - left).abs() < width + 4.0)
                })
                .unwrap_or(0);
            let y = level as f32 * 22.0;
            taken.push((left, y));
            canvas.label(left, y + 2.0, &text, colour(track.id.0));
        }
        canvas.image
    }

    /// Only what does not belong to the background.
    pub fn objects(&self, motion: &MotionStage) -> RgbImage {
        let scene = motion.scene();
        let only: Vec<u8> =
            scene.picture.iter().zip(scene.mask).map(|(&p, &m)| if m != 0 { p.max(40) } else { 0 }).collect();
        Canvas::new(&only, self.raster.width, self.raster.height).image
    }

    /// The background.
    pub fn background(&self, motion: &MotionStage) -> RgbImage {
        Canvas::new(&motion.background(), self.raster.width, self.raster.height).image
    }

    /// Where everybody went in the last [`TRACK_FRAMES`] frames: a circle and a small figure each step, the object itself
    /// at the end.
    pub fn tracks(&self, motion: &MotionStage) -> RgbImage {
        let mut ground: Vec<u8> = motion.background().iter().map(|&b| b / 2).collect();
        for portrait in &self.portraits {
            portrait.paste(&self.raster, &mut ground);
        }
        let mut canvas = Canvas::new(&ground, self.raster.width, self.raster.height);
        let steps = self.history.len();
        for (age, frame) in self.history.iter().enumerate() {
            let fresh = (age + 1) as f32 / steps.max(1) as f32;
            for track in frame {
                let paint = image::Rgb(colour(track.id.0).0.map(|c| (f32::from(c) * (0.35 + 0.65 * fresh)) as u8));
                let x = canvas.at(track.axis_column + 0.5);
                let foot = canvas.at(track.rows[1] as f64 + 0.5).min(canvas.image.height() as f32 - 6.0);
                canvas.dot(x, foot, 2.0 + 1.5 * fresh, paint, track.state == TrackState::Visible);
                if age % 4 == 3 && age + 1 < steps {
                    canvas.person_icon(x, foot - 26.0, 26.0, paint);
                }
            }
        }
        if let Some(last) = self.history.back() {
            for track in last {
                let x = canvas.at(track.axis_column) + 4.0;
                canvas.label(x, canvas.at(track.rows[0] as f64) - 22.0, &track.id.to_string(), colour(track.id.0));
            }
        }
        canvas.image
    }

    /// The recent past in one picture.
    pub fn synopsis(&self, motion: &MotionStage) -> RgbImage {
        let mut picture = motion.background();
        for cutout in &self.synopsis.cutouts {
            cutout.paste(&self.raster, &mut picture);
        }
        let mut canvas = Canvas::new(&picture, self.raster.width, self.raster.height);
        let period = self.raster.wraps.then(|| canvas.at(self.raster.width as f64));
        for cutout in &self.synopsis.cutouts {
            let p = cutout.patch;
            let (left, top) = (canvas.at(p.arc.start as f64), canvas.at(p.rows[0] as f64));
            let size = (canvas.at(p.arc.width as f64), canvas.at((p.rows[1] - p.rows[0] + 1) as f64));
            canvas.frame(left, top, size.0, size.1, colour(cutout.track.0), period);
            canvas.label(left + 3.0, top + 3.0, &cutout.track.to_string(), colour(cutout.track.0));
        }
        canvas.image
    }
}

/// "3 person 12.4° 2.31 m": what a glance wants.
fn describe(track: &TrackView) -> String {
    let class = match track.class {
        ObjectClass::Person => "",
        ObjectClass::Robot => " robot",
        ObjectClass::Unknown => " ?",
        ObjectClass::Swaying | ObjectClass::Other => " thing",
    };
    let state = match track.state {
        TrackState::Visible => "",
        TrackState::Merged => " with others",
        TrackState::Hidden => " hidden",
    };
    let bearing = track.bearing_rad.to_degrees();
    let sigma = track.bearing_sigma_rad.to_degrees();
    let range = track.extent.range.map_or(String::new(), |r| format!("  {:.1}±{:.1} m", r.range_m, r.sigma_m));
    format!("{}{class}{state}  {bearing:.1}±{sigma:.1}°{range}", track.id)
}

fn draw_bearing_scale(canvas: &mut Canvas, raster: &Raster, view: &View) {
    let base = canvas.image.height() as f32;
    canvas.extend(30);
    for degrees in (-165..=180).step_by(15) {
        // The column of a bearing, found from two others: the scale is linear.
        let Some((first, _)) = view.angles_rad(0.0, 0.0) else { return };
        let step = view.steps_rad(0.0, 0.0)[0];
        let column = ((first - f64::from(degrees).to_radians()) / step).rem_euclid(raster.width as f64);
        let x = canvas.at(column + 0.5);
        let major = degrees % 30 == 0;
        canvas.line((x, base), (x, base + if major { 8.0 } else { 4.0 }), if major { WHITE } else { DIM });
        if major {
            canvas.caption(x, base + 10.0, &format!("{degrees}°"), if degrees == 0 { WHITE } else { DIM });
        }
    }
}
