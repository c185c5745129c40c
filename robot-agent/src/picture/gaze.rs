//! Virtual gaze: a perspective picture on each object, upright and as large as it is seen; windows follow their objects
//! smoothly, for a box that breathes by a pixel must not make a picture tremble.

use std::collections::BTreeMap;

use image::{RgbImage, imageops};
use protocol::angle::{difference, wrap};
use protocol::id::TrackId;
use protocol::message::TrackState;

use super::Gallery;
use super::canvas::{Canvas, colour};
use crate::optics::MountedCamera;
use crate::panorama::{GazeWindow, Lut};
use crate::tracking::{TrackView, View};

/// Most windows in one picture.
const MAX_WINDOWS: usize = 8;
/// Windows a row.
pub(super) const ROW: usize = 4;
/// Size of a window, pixels, and of the frame round it.
pub(super) const WINDOW_PX: [u32; 2] = [240, 240];
pub(super) const FRAME_PX: u32 = 2;
/// Share of the window that the object fills.
const FILL: f64 = 0.7;
/// Part of the way to where its object is that a window goes in a frame, and to how large it is: size changes slower than place.
const FOLLOWS: f64 = 0.35;
const GROWS: f64 = 0.12;
/// Narrowest and widest object that a window is made for, radians.
const WIDTH_RAD: [f64; 2] = [0.05, 1.2];

/// The windows of the objects that are seen.
#[derive(Debug, Default)]
pub(super) struct Windows(BTreeMap<TrackId, GazeWindow>);

impl Windows {
    /// A frame later.
    pub(super) fn follow(&mut self, tracks: &[TrackView]) {
        self.0.retain(|id, _| tracks.iter().any(|t| t.id == *id));
        for track in tracks.iter().filter(|t| t.state != TrackState::Hidden) {
            let goal = around(track);
            self.0
                .entry(track.id)
                .and_modify(|w| {
                    w.pan_rad = wrap(w.pan_rad + FOLLOWS * difference(goal.pan_rad, w.pan_rad));
                    w.tilt_rad += GROWS * (goal.tilt_rad - w.tilt_rad);
                    w.hfov_rad += GROWS * (goal.hfov_rad - w.hfov_rad);
                })
                .or_insert(goal);
        }
    }

    fn of(&self, track: &TrackView) -> GazeWindow {
        self.0.get(&track.id).copied().unwrap_or_else(|| around(track))
    }
}

fn around(track: &TrackView) -> GazeWindow {
    let width_rad = track.width_rad.clamp(WIDTH_RAD[0], WIDTH_RAD[1]);
    GazeWindow::around(track.bearing_rad, width_rad, track.extent.elevation_rad, WINDOW_PX, FILL)
}

fn shown(tracks: &[TrackView]) -> Vec<&TrackView> {
    tracks.iter().filter(|t| t.state != TrackState::Hidden).take(MAX_WINDOWS).collect()
}

impl Gallery {
    /// A window on each visible track, side by side, cut from the camera's own picture. A single dark window where nobody
    /// is.
    pub fn gaze(&self, frame_gray: &[u8], camera: &MountedCamera, tracks: &[TrackView]) -> RgbImage {
        let shown = shown(tracks);
        let columns = shown.len().clamp(1, ROW);
        let mut all = blank(columns, shown.len().max(1).div_ceil(columns));
        for (k, track) in shown.iter().enumerate() {
            let lut = Lut::gaze(camera, &self.windows.of(track));
            let mut gray = vec![0; (WINDOW_PX[0] * WINDOW_PX[1]) as usize];
            if lut.unwarp(frame_gray, &mut gray).is_ok() {
                put(&mut all, k, columns, &gray, track);
            }
        }
        all
    }

    /// The first row of such windows, cut from the panorama: coarser, and quick enough for each frame.
    pub(super) fn quick_gaze(&self, panorama: &[u8], tracks: &[TrackView], view: &View) -> RgbImage {
        let mut all = blank(ROW, 1);
        for (k, track) in shown(tracks).into_iter().take(ROW).enumerate() {
            let window = self.windows.of(track);
            let gray = (0..WINDOW_PX[1])
                .flat_map(|v| (0..WINDOW_PX[0]).map(move |u| (u, v)))
                .map(|(u, v)| {
                    let d = window.direction(f64::from(u), f64::from(v));
                    let column = view.column_of_bearing(d.y.atan2(d.x))?;
                    let row = view.row_of_elevation(d.z.atan2(d.x.hypot(d.y)))?;
                    self.bilinear(panorama, column, row)
                })
                .map(Option::unwrap_or_default)
                .collect::<Vec<u8>>();
            put(&mut all, k, ROW, &gray, track);
        }
        all
    }

    fn bilinear(&self, picture: &[u8], column: f64, row: f64) -> Option<u8> {
        let (width, height) = (self.raster.width, self.raster.height);
        if !(0.0..=(height - 1) as f64).contains(&row) {
            return None;
        }
        let column = self.raster.wrap_column(column);
        let (x, y) = (column.floor(), row.floor());
        let (fx, fy) = (column - x, row - y);
        let (x, y) = ((x.max(0.0) as usize).min(width - 1), y as usize);
        let (right, below) = ((x + 1) % width, (y + 1).min(height - 1));
        let at = |x: usize, y: usize| f64::from(picture[y * width + x]);
        let above = at(x, y) + fx * (at(right, y) - at(x, y));
        let lower = at(x, below) + fx * (at(right, below) - at(x, below));
        Some((above + fy * (lower - above)).round() as u8)
    }
}

fn blank(columns: usize, rows: usize) -> RgbImage {
    let [w, h] = WINDOW_PX.map(|side| side + 2 * FRAME_PX);
    RgbImage::new(w * columns as u32, h * rows as u32)
}

fn put(all: &mut RgbImage, k: usize, columns: usize, gray: &[u8], track: &TrackView) {
    let [w, h] = WINDOW_PX;
    let mut canvas = Canvas::enlarged(gray, w as usize, h as usize, 1);
    let text = format!("{}  {:.0}°", track.id, track.bearing_rad.to_degrees());
    canvas.label(4.0, 4.0, &text, colour(track.id.0));
    let [x, y] = [(k % columns) as u32 * (w + 2 * FRAME_PX), (k / columns) as u32 * (h + 2 * FRAME_PX)];
    imageops::replace(all, &canvas.image, i64::from(x + FRAME_PX), i64::from(y + FRAME_PX));
}

#[cfg(test)]
mod tests {
    use protocol::message::{ElevationEnd, ObjectClass};

    use super::*;
    use crate::motion::Arc;
    use crate::tracking::Extent;

    fn track(bearing_rad: f64, width_rad: f64) -> TrackView {
        TrackView {
            id: TrackId(3),
            state: TrackState::Visible,
            class: ObjectClass::Person,
            arc: Arc { start: 0, width: 10 },
            rows: [10, 100],
            area_px: 100,
            axis_column: 5.0,
            bearing_rad,
            bearing_sigma_rad: 0.01,
            extent: Extent { elevation_rad: [-0.2, 0.3], sigma_rad: 0.01, ends: [ElevationEnd::Seen; 2], range: None },
            width_rad,
            confidence: 1.0,
            doubtful: false,
            appearance: None,
        }
    }

    #[test]
    fn a_window_follows_over_the_seam_without_trembling() {
        let mut windows = Windows::default();
        let mut pans = Vec::new();
        for n in 0..40 {
            // Walks 0.02 rad a frame over ±π; the box breathes by a fifth and the bearing by 0.01.
            let noise = if n % 2 == 0 { 1.0 } else { -1.0 };
            let seen = track(wrap(2.9 + 0.02 * f64::from(n) + 0.01 * noise), 0.2 * (1.0 + 0.2 * noise));
            windows.follow(std::slice::from_ref(&seen));
            let window = windows.of(&seen);
            // Never far from the object: a tenth of the window.
            assert!(difference(window.pan_rad, seen.bearing_rad).abs() < 0.1 * window.hfov_rad, "{n}");
            pans.push(window.pan_rad);
        }
        let steps: Vec<f64> = pans[10..].windows(2).map(|w| difference(w[1], w[0])).collect();
        assert!(steps.iter().all(|s| (0.008..0.032).contains(s)), "{steps:?}");
        windows.follow(&[]);
        assert!(windows.0.is_empty());
    }
}
