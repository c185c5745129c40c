//! Virtual gaze: a perspective picture on each object, upright and as large as it is seen.

use image::{RgbImage, imageops};
use protocol::message::TrackState;

use super::Gallery;
use super::canvas::{Canvas, colour};
use crate::optics::MountedCamera;
use crate::panorama::{GazeWindow, Lut};
use crate::tracking::TrackView;

/// Most windows in one picture.
const MAX_WINDOWS: usize = 8;
/// Size of a window, pixels.
const WINDOW_PX: [u32; 2] = [240, 240];
/// Share of the window that the object fills.
const FILL: f64 = 0.7;

impl Gallery {
    /// A window on each visible track, side by side, cut from the camera's own picture. A single dark window where nobody
    /// is.
    pub fn gaze(&self, frame_gray: &[u8], camera: &MountedCamera, tracks: &[TrackView]) -> RgbImage {
        let shown: Vec<&TrackView> =
            tracks.iter().filter(|t| t.state != TrackState::Hidden).take(MAX_WINDOWS).collect();
        let [w, h] = WINDOW_PX;
        let n = shown.len().max(1) as u32;
        let columns = n.min(4);
        let mut all = RgbImage::new((w + 4) * columns, (h + 4) * n.div_ceil(columns));
        for (k, track) in shown.iter().enumerate() {
            let width_rad = track.width_rad.clamp(0.05, 1.2);
            let window = GazeWindow::around(track.bearing_rad, width_rad, track.extent.elevation_rad, WINDOW_PX, FILL);
            let lut = Lut::gaze(camera, &window);
            let mut gray = vec![0; (w * h) as usize];
            if lut.unwarp(frame_gray, &mut gray).is_err() {
                continue;
            }
            let mut canvas = Canvas::enlarged(&gray, w as usize, h as usize, 1);
            let text = format!("{}  {:.0}°", track.id, track.bearing_rad.to_degrees());
            canvas.label(4.0, 4.0, &text, colour(track.id.0));
            let (x, y) = (k as u32 % columns * (w + 4) + 2, k as u32 / columns * (h + 4) + 2);
            imageops::replace(&mut all, &canvas.image, i64::from(x), i64::from(y));
        }
        all
    }
}
