//! Does the robot itself move? Told from the picture alone, among people who move.
//!
//! The picture is cut into sectors of a few degrees. Each one is compared with the same sector of a reference picture by
//! least squares: C ≈ R + b + a·R − s·∂R/∂x − t·∂R/∂y, a shift (s, t) in pixels with the light's gain and offset as nuisances.
//! The insight: when the robot moves, *no* sector stays (but the few it drives towards); when people move, however near,
//! sectors without them stay. So standing needs a share of still sectors, not an absence of change.
//!
//! * Standing → moving: sectors against an *anchor* (the background). Vibration stays near it, a slow drive leaves it:
//!   0.1 m/s gives 0.6 px in a third of a second on a wall 4 m away.
//! * Moving → standing: sectors against the frame before, for three frames: 0.05 m/s is told from standing still.
//! * Turning: the whole ring shifted by one amount (column profiles matched over the ring), otherwise moving.

use protocol::message::Motion;

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

/// About 5° on a panorama.
const SECTORS: usize = 72;
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
/// Frames in a row that decide.
const FRAMES_TO_LEAVE: u32 = 2;
const FRAMES_TO_STAND: u32 = 3;

/// The judge of own motion, with its memory.
#[derive(Debug)]
pub(crate) struct OwnMotion {
    raster: Raster,
    valid: Vec<u8>,
    state: Motion,
    count: u32,
    previous: Vec<u8>,
    sums: kernel::Sums,
}

impl OwnMotion {
    pub(crate) fn new(raster: Raster, valid: Vec<u8>) -> Self {
        let sums = kernel::Sums::new(raster.width);
        Self { raster, valid, state: Motion::Unknown, count: 0, previous: Vec::new(), sums }
    }

    /// Judge a picture. `anchor`: the background, where there is one. `noise_sigma`: grey levels.
    /// Returns what the robot does and, against the anchor, how the sectors fared.
    pub(crate) fn step(&mut self, picture: &[u8], anchor: Option<&[u8]>, noise_sigma: f64) -> (Motion, Comparison) {
        let mut against_anchor = Comparison::default();
        match (self.state, anchor) {
            (Motion::Standing, Some(anchor)) => {
                against_anchor = self.compare(anchor, picture, ANCHOR_TOLERANCE_PX, noise_sigma);
                let left = against_anchor.textured >= MIN_SECTORS && against_anchor.still_share() < LEFT_SHARE;
                self.count = if left { self.count + 1 } else { 0 };
                if self.count >= FRAMES_TO_LEAVE {
                    self.state = self.kind_of_motion(picture);
                    self.count = 0;
                }
            }
            _ if self.previous.is_empty() => self.state = Motion::Unknown,
            _ => {
                let previous = std::mem::take(&mut self.previous);
                let c = self.compare(&previous, picture, FRAME_TOLERANCE_PX, noise_sigma);
                self.previous = previous;
                let still = c.textured < MIN_SECTORS || c.still_share() > STILL_SHARE;
                self.count = if still { self.count + 1 } else { 0 };
                if self.count >= FRAMES_TO_STAND {
                    self.state = Motion::Standing;
                    self.count = 0;
                } else if !still {
                    self.state = self.kind_of_motion(picture);
                }
            }
        }
        self.previous.clear();
        self.previous.extend_from_slice(picture);
        (self.state, against_anchor)
    }

    /// Forget the past: the next frames decide anew.
    pub(crate) fn reset(&mut self) {
        self.state = Motion::Unknown;
        self.count = 0;
        self.previous.clear();
    }

    fn compare(&mut self, reference: &[u8], picture: &[u8], tolerance_px: f64, noise_sigma: f64) -> Comparison {
        let Raster { width, height, wraps } = self.raster;
        self.sums.clear();
        // Every third row: neighbours are blurred into each other anyway.
        for y in (1..height.saturating_sub(1)).step_by(3) {
            let row = |y: usize| y * width..(y + 1) * width;
            kernel::accumulate(
                &reference[row(y - 1)],
                &reference[row(y)],
                &reference[row(y + 1)],
                &picture[row(y)],
                &self.valid[row(y)],
                wraps,
                &mut self.sums,
            );
        }
        let mut comparison = Comparison::default();
        for sector in 0..SECTORS {
            let columns = sector * width / SECTORS..(sector + 1) * width / SECTORS;
            let Some(fit) = self.sums.solve(columns) else { continue };
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
        }
        comparison
    }

    /// Turning if the whole ring has shifted by one amount since the frame before.
    fn kind_of_motion(&self, picture: &[u8]) -> Motion {
        if !self.raster.wraps || self.previous.is_empty() {
            return Motion::Moving;
        }
        let shift = kernel::ring_shift(&self.previous, picture, self.raster.width, self.raster.height);
        let turned = shift.columns.abs() >= 1.0 && shift.misfit < 0.4 * shift.misfit_at_zero;
        if turned { Motion::Turning } else { Motion::Moving }
    }
}
