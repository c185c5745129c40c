//! When to lock a camera's exposure: once its pictures are steady; when to let it go: when they have long been too dark or bright.

use std::collections::VecDeque;

/// Frames that must be equally bright, and by how much their means may differ, grey levels.
const STEADY_FRAMES: usize = 10;
const STEADY_LEVELS: f64 = 2.0;
/// Frames after which it is locked in any case: a lamp may flicker for ever.
const MOST_FRAMES: u32 = 60;
/// Mean grey levels outside of which a locked exposure is wrong, and for how many frames.
const GOOD_LEVELS: [f64; 2] = [15.0, 225.0];
const WRONG_FRAMES: u32 = 45;
/// Every so many pixels are looked at.
const STRIDE: usize = 61;

/// What is known of the brightness of late.
#[derive(Debug, Default)]
pub(super) struct Exposure {
    means: VecDeque<f64>,
    frames: u32,
    locked: bool,
    wrong: u32,
}

impl Exposure {
    /// Looks at a frame; whether to lock (`true`) or to let go now.
    pub(super) fn look(&mut self, gray: &[u8]) -> Option<bool> {
        let (sum, n) = gray.iter().step_by(STRIDE).fold((0u64, 0u64), |(sum, n), g| (sum + u64::from(*g), n + 1));
        let mean = sum as f64 / n.max(1) as f64;
        self.frames += 1;
        if self.locked {
            let good = (GOOD_LEVELS[0]..=GOOD_LEVELS[1]).contains(&mean);
            self.wrong = if good { 0 } else { self.wrong + 1 };
            if self.wrong < WRONG_FRAMES {
                return None;
            }
            *self = Self::default();
            return Some(false);
        }
        self.means.push_back(mean);
        if self.means.len() > STEADY_FRAMES {
            self.means.pop_front();
        }
        let span = self.means.iter().fold([f64::MAX, f64::MIN], |[low, high], m| [low.min(*m), high.max(*m)]);
        let steady = self.means.len() == STEADY_FRAMES && span[1] - span[0] < STEADY_LEVELS;
        self.locked = steady || self.frames >= MOST_FRAMES;
        self.locked.then_some(true)
    }
}
