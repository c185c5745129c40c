//! Marks where a picture is worked, none where it rests.

use super::{Background, CELL_ROWS, MotionStage, halo, kernel};

impl MotionStage {
    /// Marks a band of rows where it is worked; how many pixels differ strongly, or 0 where that is not `counted`.
    pub(super) fn mark_band(&mut self, band: usize, exposure_q15: u16, floors: [u16; 2], counted: bool) -> usize {
        let (width, stride) = (self.raster.width, self.faint.stride());
        let Background { level, noise, .. } = &self.background;
        let rows = band * halo::CELL..((band + 1) * halo::CELL).min(self.raster.height);
        let mut differing = 0;
        for run in self.work.worked(rows.start / CELL_ROWS) {
            let (first, first_word) = (rows.start * width + run.columns.start, rows.start * stride + run.words.start);
            let piece = kernel::Compared {
                picture: &self.picture[first..],
                exposure_q15,
                background: &level[first..],
                noise: &noise[first..],
                floors,
                size: [run.columns.len(), rows.len()],
                width,
            };
            let mut marked = kernel::Marked {
                magnitude: &mut self.magnitude[first..],
                most: &mut self.halo.most()[run.columns.clone()],
                faint: &mut self.faint.words_mut()[first_word..],
                strong: &mut self.strong.words_mut()[first_word..],
                stride,
            };
            kernel::mark_changes(piece, &mut marked);
            if self.partly_valid[band] {
                for y in rows.clone() {
                    let valid = &self.valid_marks.row(y)[run.words.clone()];
                    for marks in [&mut self.faint, &mut self.strong] {
                        let words = &mut marks.words_mut()[run.marks(y, stride)];
                        words.iter_mut().zip(valid).for_each(|(word, valid)| *word &= valid);
                    }
                }
            }
            let (faint, strong) = (&mut self.faint, &mut self.strong);
            self.background.forgive_known(&self.picture, exposure_q15, rows.clone(), &run, faint, strong);
            if counted {
                let words = rows.clone().flat_map(|y| &self.strong.words()[run.marks(y, stride)]);
                differing += words.map(|word| word.count_ones() as usize).sum::<usize>();
            }
        }
        differing
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
