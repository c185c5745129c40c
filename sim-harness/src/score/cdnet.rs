//! Masks of moving pixels against ChangeDetection.net's truth (Wang et al., CVPRW 2014).
//!
//! ```text
//! truth  0 static · 50 shadow · 85 outside the region of interest · 170 unknown · 255 motion
//! scored motion against static and shadow, inside ROI.bmp, on the frames of temporalROI.txt; 85 and 170 count nowhere
//! ```
//!
//! All pixels of all frames are counted together, as the benchmark does for a sequence.

use std::path::{Path, PathBuf};

use serde::Serialize;

/// Why masks cannot be scored.
#[derive(Debug, thiserror::Error)]
pub enum CdnetError {
    /// A file that cannot be read as what it should be.
    #[error("{}: {why}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// A mask of another size than its truth.
    #[error("{}: {found:?} pixels, the truth has {wanted:?}", path.display())]
    Size {
        /// The mask.
        path: PathBuf,
        /// Its columns and rows.
        found: (u32, u32),
        /// Those of the truth.
        wanted: (u32, u32),
    },
}

/// Counts of pixels and what follows from them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct MaskScores {
    /// Frames that were scored.
    pub frames: usize,
    /// Motion found.
    pub true_positives: u64,
    /// Static or shadow taken for motion.
    pub false_positives: u64,
    /// Motion missed.
    pub false_negatives: u64,
    /// Static or shadow left alone.
    pub true_negatives: u64,
    /// Of the false positives: in shadow.
    pub in_shadow: u64,
    /// TP / (TP + FN).
    pub recall: f64,
    /// TP / (TP + FP).
    pub precision: f64,
    /// 2 · precision · recall / (precision + recall).
    pub f_measure: f64,
}

impl MaskScores {
    /// Adds one frame; values of masks other than 0 are motion. `region` is 0 outside the region of interest.
    pub fn add(&mut self, mask: &[u8], truth: &[u8], region: &[u8]) {
        self.frames += 1;
        for ((&m, &t), _) in mask.iter().zip(truth).zip(region).filter(|(_, r)| **r != 0) {
            match (t, m != 0) {
                (255, true) => self.true_positives += 1,
                (255, false) => self.false_negatives += 1,
                (0 | 50, true) => {
                    self.false_positives += 1;
                    self.in_shadow += u64::from(t == 50);
                }
                (0 | 50, false) => self.true_negatives += 1,
                _ => {}
            }
        }
        let ratio = |part: u64, rest: u64| if part == 0 { 0.0 } else { part as f64 / (part + rest) as f64 };
        self.recall = ratio(self.true_positives, self.false_negatives);
        self.precision = ratio(self.true_positives, self.false_positives);
        let sum = self.recall + self.precision;
        self.f_measure = if sum > 0.0 { 2.0 * self.recall * self.precision / sum } else { 0.0 };
    }
}

/// Scores `masks/NNNNNN.png` (the first is 0) against a sequence as the benchmark gives it: `groundtruth/gtNNNNNN.png` (the first
/// is 1), `ROI.bmp`, `temporalROI.txt`.
///
/// # Errors
/// A file that is missing or has another size.
pub fn score(sequence: &Path, masks: &Path) -> Result<MaskScores, CdnetError> {
    let (size, region) = gray(&sequence.join("ROI.bmp"))?;
    let [first, last] = temporal_region(&sequence.join("temporalROI.txt"))?;
    let mut scores = MaskScores::default();
    for frame in first..=last {
        let (truth_size, truth) = gray(&sequence.join(format!("groundtruth/gt{frame:06}.png")))?;
        let path = masks.join(format!("{:06}.png", frame - 1));
        let (found, mask) = gray(&path)?;
        if found != truth_size || found != size {
            return Err(CdnetError::Size { path, found, wanted: truth_size });
        }
        scores.add(&mask, &truth, &region);
    }
    Ok(scores)
}

fn gray(path: &Path) -> Result<((u32, u32), Vec<u8>), CdnetError> {
    let picture =
        image::open(path).map_err(|e| CdnetError::File { path: path.to_owned(), why: e.to_string() })?.into_luma8();
    Ok((picture.dimensions(), picture.into_raw()))
}

/// "470 1700": first and last frame, counted from 1.
fn temporal_region(path: &Path) -> Result<[u32; 2], CdnetError> {
    let wrong = |why: String| CdnetError::File { path: path.to_owned(), why };
    let text = std::fs::read_to_string(path).map_err(|e| wrong(e.to_string()))?;
    let numbers: Vec<u32> = text.split_whitespace().map_while(|n| n.parse().ok()).collect();
    match numbers[..] {
        [first, last] if first >= 1 && first <= last => Ok([first, last]),
        _ => Err(wrong(format!("\"{}\": the first and the last frame, counted from 1, were expected", text.trim()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shadow_is_no_motion_and_unknown_pixels_count_nowhere() {
        let truth = [255, 255, 255, 0, 50, 50, 85, 170, 255];
        let mask = [255, 255, 0, 255, 255, 0, 255, 255, 255];
        let region = [1, 1, 1, 1, 1, 1, 1, 1, 0];
        let mut scores = MaskScores::default();
        scores.add(&mask, &truth, &region);
        let counts = [
            scores.true_positives,
            scores.false_positives,
            scores.false_negatives,
            scores.true_negatives,
            scores.in_shadow,
        ];
        assert_eq!(counts, [2, 2, 1, 1, 1]);
        assert!((scores.recall - 2.0 / 3.0).abs() < 1e-12 && (scores.precision - 0.5).abs() < 1e-12);
        assert!((scores.f_measure - 4.0 / 7.0).abs() < 1e-12);
    }
}
