//! A picture that is drawn only where it is worked.
//!
//! A whole picture is drawn into a buffer of its own, and buffers change places. A part is drawn over the last picture, and what it is
//! drawn over is kept in that buffer: so copying costs as much as is drawn.

use protocol::message::Motion;

use super::{BackgroundState, MotionStage, Work};

/// A new background is worked whole for so many frames: its noise is not well known yet.
const SETTLING_FRAMES: u32 = 12;

/// A picture that is to be drawn.
#[derive(Debug)]
pub struct Drawing<'a> {
    stage: &'a mut MotionStage,
}

impl Drawing<'_> {
    /// Which cells must be drawn.
    pub fn work(&mut self) -> &mut Work {
        &mut self.stage.work
    }

    /// Where they are to be drawn, once it is known which; the rest shows what it showed. To be called once.
    pub fn canvas(&mut self) -> Canvas<'_> {
        let MotionStage { picture, next, work, raster, drawn_in_place, .. } = &mut *self.stage;
        next.resize(raster.len(), 0);
        if work.is_whole() {
            return Canvas { picture: next, work, kept: None };
        }
        *drawn_in_place = true;
        Canvas { picture, work, kept: Some(next) }
    }
}

/// Where a picture is drawn.
#[derive(Debug)]
pub struct Canvas<'a> {
    /// All of it.
    pub picture: &'a mut [u8],
    /// Which cells are to be drawn.
    pub work: &'a Work,
    /// Where what is in those cells is to be kept, at the same place as in the picture.
    pub kept: Option<&'a mut [u8]>,
}

impl Canvas<'_> {
    /// Keeps what is in all cells that are to be drawn.
    pub(crate) fn keep(&mut self) {
        let Some(kept) = &mut self.kept else { return };
        for (band, rows) in self.work.bands() {
            for run in self.work.worked(band) {
                for y in rows.clone() {
                    let pixels = run.pixels(y, self.work.width());
                    kept[pixels.clone()].copy_from_slice(&self.picture[pixels]);
                }
            }
        }
    }
}

impl MotionStage {
    /// As [`MotionStage::next_picture`], where cells need be drawn only as far as [`Work`] says: those that it says now, and those in
    /// which something has changed, of which it is to be told. `whole`: somebody wants to see all of the picture.
    pub fn next_drawing(&mut self, whole: bool) -> Drawing<'_> {
        self.work.set_steady(self.settings.rests && self.motion == Motion::Standing && !self.sensor_failed);
        let settled = self.state == BackgroundState::Ready && self.ready_frames >= SETTLING_FRAMES;
        if settled && self.work.is_steady() {
            self.work.plan(self.spacing_s);
            if whole {
                self.work.draw_all();
            }
        } else {
            self.work.plan_all();
        }
        Drawing { stage: self }
    }

    /// Which cells of the last picture were worked.
    #[cfg(test)]
    pub(crate) fn work(&self) -> &Work {
        &self.work
    }

    /// Whether the picture is the one before, as far as it was drawn.
    pub(super) fn is_same_picture(&self) -> bool {
        if self.work.is_whole() || self.before.len() != self.picture.len() {
            return self.picture == self.before;
        }
        let width = self.raster.width;
        self.work.bands().all(|(band, rows)| {
            self.work.worked(band).all(|run| {
                rows.clone().all(|y| {
                    let pixels = run.pixels(y, width);
                    self.picture[pixels.clone()] == self.before[pixels]
                })
            })
        })
    }
}
