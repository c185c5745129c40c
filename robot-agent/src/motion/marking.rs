//! Marks where a picture is worked, none where it rests.

use super::{Background, CELL_ROWS, FETCH_ROWS, MotionStage, halo, kernel, work};

impl MotionStage {
    /// Marks a band of rows where it is worked; how many pixels differ strongly, or 0 where that is not `counted`.
    pub(super) fn mark_band(&mut self, band: usize, exposure_q15: u16, floors: [u16; 2], counted: bool) -> usize {
        let (width, stride) = (self.raster.width, self.faint.stride());
        let Background { level, noise, .. } = &self.background;
        let rows = band * halo::CELL..((band + 1) * halo::CELL).min(self.raster.height);
        let mut differing = 0;
        for run in self.work.worked(rows.start / CELL_ROWS) {
            for y in rows.clone() {
                self.fetch_row(y + FETCH_ROWS, &run);
                let pixels = run.pixels(y, width);
                let words = run.marks(y, stride);
                let row = kernel::Compared {
                    picture: &self.picture[pixels.clone()],
                    exposure_q15,
                    background: &level[pixels.clone()],
                    noise: &noise[pixels.clone()],
                    floors,
                };
                let faint = &mut self.faint.words_mut()[words.clone()];
                let strong = &mut self.strong.words_mut()[words];
                let most = &mut self.halo.most()[run.columns.clone()];
                kernel::mark_changes(row, &mut self.magnitude[pixels.clone()], most, faint, strong);
                if self.partly_valid[band] {
                    let valid = &self.valid_marks.row(y)[run.words.clone()];
                    for ((f, s), v) in faint.iter_mut().zip(strong.iter_mut()).zip(valid) {
                        (*f, *s) = (*f & v, *s & v);
                    }
                }
                self.background.forgive_known(&self.picture[pixels], exposure_q15, y, &run, faint, strong);
                if counted {
                    differing += strong.iter().map(|s| s.count_ones() as usize).sum::<usize>();
                }
            }
        }
        differing
    }

    /// Fetches some pixels of a row into the cache.
    fn fetch_row(&self, y: usize, run: &work::Run) {
        let pixels = run.pixels(y, self.raster.width);
        self.background.fetch(y, run);
        for pixels in [self.picture.get(pixels.clone()), self.magnitude.get(pixels)].into_iter().flatten() {
            kernel::fetch(pixels);
        }
    }

    /// Where the frame before was worked and this one is not nothing is marked.
    pub(super) fn wipe_left(&mut self) {
        let (width, stride) = (self.raster.width, self.faint.stride());
        for (band, rows) in self.work.bands() {
            for run in self.work.left(band) {
                for y in rows.clone() {
                    self.magnitude[run.pixels(y, width)].fill(0);
                    for marks in [&mut self.faint, &mut self.strong] {
                        marks.words_mut()[run.marks(y, stride)].fill(0);
                    }
                }
            }
        }
    }
}
