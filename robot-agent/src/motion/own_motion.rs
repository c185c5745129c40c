//! Does the robot itself move? Told from the picture alone, among people who move.
//!
//! The picture is cut into sectors of a few degrees. Each one is compared with the same sector of a reference picture by
//! least squares: C ≈ R + b + a·R − s·∂R/∂x − t·∂R/∂y, a shift (s, t) in pixels with the light's gain and offset as nuisances.
//! The insight: when the robot moves, *no* sector stays (but the few it drives towards); when people move, however near,
//! sectors without them stay. So standing needs a share of still sectors, not an absence of change.
//!
//! * Standing → moving: sectors against an *anchor* (the background). Vibration stays near it, a slow drive leaves it:
//!   0.1 m/s gives 0.6 px in a third of a second on a wall 4 m away.
//! * Moving → standing: sectors against the frame a tenth of a second before, for three frames: 0.05 m/s is told from standing still.
//! * Turning: the whole ring shifted by one amount (column profiles matched over the ring), otherwise moving.

use std::ops::Range;

use protocol::message::Motion;
use protocol::time::Timestamp;

use super::raster::Raster;

mod kernel;

/// What a comparison with a reference says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Comparison {
    /// Sectors with enough texture to tell a shift.
    pub(crate) textured: usize,
    /// Of them: explained by no shift.
    pub(crate) still: usize,
    /// Of the still ones: gain or offset changed clearly.
    pub(crate) relit: usize,
}

impl Comparison {
    fn still_share(&self) -> f64 {
        if self.textured == 0 { 1.0 } else { self.still as f64 / self.textured as f64 }
    }

    /// Whether the picture stands but its light has changed.
    pub(crate) fn is_relit(&self) -> bool {
        self.textured >= MIN_SECTORS && self.still_share() > 0.3 && 2 * self.relit > self.still
    }
}

/// About 5° on a panorama, and not much less than half as wide where a camera sees a small part of one.
const SECTORS: usize = 72;
const LEAST_SECTORS: usize = 12;
/// From one sector that is judged to the next; has no factor in common with their number.
const SECTOR_JUMP: usize = 29;
/// Fewer textured sectors cannot tell.
const MIN_SECTORS: usize = 6;
/// Still against the anchor: vibration of half a pixel passes.
const ANCHOR_TOLERANCE_PX: f64 = 0.6;
/// Still against the frame before.
const FRAME_TOLERANCE_PX: f64 = 0.12;
/// Below this share of still sectors the robot has left its anchor …
const LEFT_SHARE: f64 = 0.25;
/// … and above this share, frame by frame, it stands again.
const STILL_SHARE: f64 = 0.5;
/// A standing robot is compared with its anchor so often at most, seconds: a fast camera's frames say nothing new. More seldom where
/// little of the picture has changed, for a robot that drives changes all of it.
const COMPARE_S: f64 = 0.082;
const COMPARE_CALM_S: f64 = 0.282;
/// Frames in a row that decide.
const FRAMES_TO_LEAVE: u32 = 2;
const FRAMES_TO_STAND: u32 = 3;

/// What the robot must not leave.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Anchor<'a> {
    /// Grey levels.
    Picture(&'a [u8]),
    /// In 8.8 fixed point.
    Background(&'a [u16]),
}

/// The judge of own motion, with its memory.
#[derive(Debug)]
pub(crate) struct OwnMotion {
    raster: Raster,
    valid: Vec<u8>,
    /// Columns between which the camera sees, and in how many sectors they are judged.
    arc: Range<usize>,
    sectors: usize,
    state: Motion,
    count: u32,
    /// When a standing robot was last compared with its anchor.
    compared: Option<Timestamp>,
}

impl OwnMotion {
    pub(crate) fn new(raster: Raster, valid: Vec<u8>) -> Self {
        let seen = |column: usize| valid.iter().skip(column).step_by(raster.width).any(|v| *v != 0);
        let first = (0..raster.width).find(|column| seen(*column)).unwrap_or(0);
        let last = (0..raster.width).rfind(|column| seen(*column)).unwrap_or(raster.width - 1);
        let arc = first..last + 1;
        let share = arc.len() as f64 / raster.width as f64;
        let sectors = LEAST_SECTORS + ((SECTORS - LEAST_SECTORS) as f64 * share) as usize;
        let sectors = if sectors.is_multiple_of(SECTOR_JUMP) { sectors + 1 } else { sectors };
        Self { raster, valid, arc, sectors, state: Motion::Unknown, count: 0, compared: None }
    }

    /// Judge a picture. `before`: one a tenth of a second before, or the last of a slower camera, empty where there is none; `anchor`: the background, where there is one;
    /// `noise_sigma`: grey levels; `calm`: whether little of it has changed, as somebody else has seen.
    pub(crate) fn step(
        &mut self,
        picture: &[u8],
        before: &[u8],
        anchor: Option<Anchor<'_>>,
        noise_sigma: f64,
        capture: Timestamp,
        calm: bool,
    ) -> Motion {
        match (self.state, anchor) {
            (Motion::Standing, Some(_)) if self.was_compared(capture, calm) => {}
            (Motion::Standing, Some(anchor)) => {
                self.compared = Some(capture);
                let c = self.compare(anchor, picture, ANCHOR_TOLERANCE_PX, noise_sigma, Some(LEFT_SHARE));
                let left = c.textured >= MIN_SECTORS && c.still_share() < LEFT_SHARE;
                self.count = if left { self.count + 1 } else { 0 };
                if self.count >= FRAMES_TO_LEAVE {
                    self.state = self.kind_of_motion(picture, before);
                    self.count = 0;
                }
            }
            _ if before.len() != picture.len() => self.state = Motion::Unknown,
            _ => {
                let frame = Anchor::Picture(before);
                let c = self.compare(frame, picture, FRAME_TOLERANCE_PX, noise_sigma, Some(STILL_SHARE));
                let still = c.textured < MIN_SECTORS || c.still_share() > STILL_SHARE;
                self.count = if still { self.count + 1 } else { 0 };
                if self.count >= FRAMES_TO_STAND {
                    self.state = Motion::Standing;
                    self.count = 0;
                } else if !still {
                    self.state = self.kind_of_motion(picture, before);
                }
            }
        }
        self.state
    }

    /// Whether a standing robot was compared with its anchor a short while ago.
    fn was_compared(&self, capture: Timestamp, calm: bool) -> bool {
        // A robot that seems to have left is looked at again soon.
        let spacing_s = if calm && self.count == 0 { COMPARE_CALM_S } else { COMPARE_S };
        self.compared.is_some_and(|then| (0.0..spacing_s).contains(&capture.seconds_since(then)))
    }

    /// Whether the picture stands where the anchor was, but its light has changed.
    pub(crate) fn is_relit(&self, picture: &[u8], anchor: Option<Anchor<'_>>, noise_sigma: f64) -> bool {
        anchor.is_some_and(|a| self.compare(a, picture, ANCHOR_TOLERANCE_PX, noise_sigma, None).is_relit())
    }

    /// Forget the past: the next frames decide anew.
    pub(crate) fn reset(&mut self) {
        self.state = Motion::Unknown;
        self.count = 0;
        self.compared = None;
    }

    /// Sector by sector, in an order that jumps about the ring; until more than `enough` of all sectors are still, whatever the
    /// others do.
    fn compare(
        &self,
        reference: Anchor<'_>,
        picture: &[u8],
        tolerance_px: f64,
        noise_sigma: f64,
        enough: Option<f64>,
    ) -> Comparison {
        let (arc, sectors) = (&self.arc, self.sectors);
        let enough = enough.map_or(sectors, |share| (share * sectors as f64) as usize);
        let mut comparison = Comparison::default();
        for k in 0..sectors {
            let sector = k * SECTOR_JUMP % sectors;
            let border = |k: usize| arc.start + k * arc.len() / sectors;
            let columns = border(sector)..border(sector + 1);
            let sums = match reference {
                Anchor::Picture(r) => kernel::against_picture(r, picture, &self.valid, &self.raster, columns),
                Anchor::Background(r) => kernel::against_background(r, picture, &self.valid, &self.raster, columns),
            };
            let Some(fit) = sums.solve() else { continue };
            // A shift of 0.3 px must stand out of the noise by three sigmas.
            let sigma_px = fit.sigma_per_noise * noise_sigma * std::f64::consts::SQRT_2;
            if sigma_px > 0.1 {
                continue;
            }
            comparison.textured += 1;
            let explained = fit.residual_variance < 30f64.max(12.0 * noise_sigma * noise_sigma);
            if explained && fit.shift_px.iter().all(|s| s.abs() < tolerance_px + 2.5 * sigma_px) {
                comparison.still += 1;
                comparison.relit += usize::from(fit.mean_change > 6.0 || fit.gain_change.abs() > 0.08);
            }
            if comparison.still > enough {
                break;
            }
        }
        comparison
    }

    /// Turning if the whole ring has shifted by one amount since the frame before.
    fn kind_of_motion(&self, picture: &[u8], before: &[u8]) -> Motion {
        if !self.raster.wraps || before.len() != picture.len() {
            return Motion::Moving;
        }
        let shift = kernel::ring_shift(before, picture, self.raster.width, self.raster.height);
        let turned = shift.columns.abs() >= 1.0 && shift.misfit < 0.4 * shift.misfit_at_zero;
        if turned { Motion::Turning } else { Motion::Moving }
    }
}
