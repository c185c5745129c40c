//! What the scene looks like without the things that move: a level and a noise estimate a pixel.
//!
//! The report's two modes (`MATHS.md` §7.2, §7.3; report VI.3): *permanent*, the exact median of n frames, and
//! *instantaneous*, the first frame followed by a running average outside objects. A robot that has just stopped has
//! people in view and one second to be useful, so the default is between them: the median of the first second (which loses
//! whoever walks), followed by the running average, while those who stood in the first frames leave a *ghost* that is
//! recognised by its edges (see `ghost`) and removed.
//!
//! One second is not enough to lose somebody who walks towards the robot, so in the live mode each pixel has a *second look*
//! beside its background: what else is seen there, and for how many frames each of the two was. The look seen longer is
//! the background; one that was the background before is still known and is no object when it is seen again. So a background
//! that was seen for half a minute is not moved by somebody who stops, and where the tracker follows somebody time counts
//! for a third.
//!
//! In a crowd that stood before the robot when it stopped a pixel shows many looks, and no second one for long. So in its
//! first seconds a background is *thought over*: some frames are kept, and what a pixel showed in most of them is its
//! background.
//!
//! The noise estimate is a running mean of |C − B| outside objects, so thresholds follow the camera, its gain, flickering
//! lamps and vibrating edges, pixel by pixel.

use std::ops::Range;

use protocol::time::Timestamp;

use super::kernel;
use super::marks::{Marks, WORD};
use super::raster::Raster;
use super::work::Run;

/// How a background comes about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BackgroundMode {
    /// Median of `frames` frames (2 … 255), each `every`-th one; then unchanged until it is restarted.
    Permanent {
        /// n of the median.
        frames: usize,
        /// 1 takes each frame.
        every: usize,
    },
    /// The first frame, then the running average outside objects.
    Instantaneous,
    /// Median of the frames of the first `bootstrap_s` seconds, then the running average outside objects.
    Live {
        /// 0.8 leaves a fifth of the second for noticing that the robot stands.
        bootstrap_s: f64,
    },
}

/// Most frames of a bootstrap in [`BackgroundMode::Live`]: an odd number, so that the median is a middle.
const LIVE_FRAMES: usize = 9;

/// Level and noise of each pixel, 8.8 fixed point.
#[derive(Debug)]
pub struct Background {
    mode: BackgroundMode,
    width: usize,
    /// Words of a row of `known`.
    stride: usize,
    /// Background grey level.
    pub(super) level: Vec<u16>,
    /// Mean absolute deviation of the picture from `level` where nothing moves.
    pub(super) noise: Vec<u16>,
    /// Where `noise` saturates.
    most_noise: u16,
    /// Second look of each pixel; empty but in the live mode.
    second: Vec<u16>,
    seen: Vec<u8>,
    seen_second: Vec<u8>,
    /// Marked where the second look was the background before, as [`super::marks::Marks`] are.
    known: Vec<u64>,
    /// Whether any second look may be known.
    any_known: bool,
    /// Frames collected for the median; of a young background in the live mode, those it is thought over by; then empty.
    stack: Vec<Vec<u8>>,
    arrived: usize,
    first_capture: Timestamp,
    last_taken: Timestamp,
    ready: bool,
}

impl Background {
    /// Nothing known yet, for pictures of one size.
    pub fn new(mode: BackgroundMode, raster: Raster) -> Self {
        let len = raster.len();
        let stride = raster.width.div_ceil(WORD);
        let [looks, words] =
            if matches!(mode, BackgroundMode::Live { .. }) { [len, stride * raster.height] } else { [0, 0] };
        Self {
            mode,
            width: raster.width,
            stride,
            level: vec![0; len],
            noise: vec![0; len],
            most_noise: kernel::NOISE_MAX,
            second: vec![0; looks],
            seen: vec![0; looks],
            seen_second: vec![0; looks],
            known: vec![0; words],
            any_known: false,
            stack: Vec::new(),
            arrived: 0,
            first_capture: Timestamp(0),
            last_taken: Timestamp(0),
            ready: false,
        }
    }

    /// The same, indoors: nothing there is as restless as leaves in the wind, and clothes like the wall are not to be missed.
    pub fn indoors(mut self) -> Self {
        self.most_noise = kernel::INDOOR_NOISE_MAX;
        self
    }

    /// Whether it can be subtracted.
    pub fn is_ready(&self) -> bool {
        self.ready
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        let wide = [&self.level, &self.noise, &self.second].map(|v| size_of_val(&**v));
        let narrow = [&self.seen, &self.seen_second].map(Vec::len);
        let known = size_of_val(&*self.known);
        let stack: usize = self.stack.iter().map(Vec::len).sum();
        wide.iter().sum::<usize>() + narrow.iter().sum::<usize>() + known + stack
    }

    /// Grey levels, rounded.
    pub fn levels(&self) -> Vec<u8> {
        let mut levels = vec![0; self.level.len()];
        kernel::round_levels(&self.level, &mut levels);
        levels
    }

    /// Forget everything; the next frame is the first.
    pub fn restart(&mut self) {
        self.stack.clear();
        self.arrived = 0;
        self.ready = false;
    }

    /// Take a frame while the background is not ready; true when it has become ready with it. `valid`: 0 where nothing is tested.
    pub fn collect(&mut self, picture: &[u8], valid: &[u8], capture: Timestamp) -> bool {
        if self.arrived == 0 {
            self.first_capture = capture;
        }
        self.arrived += 1;
        let elapsed_s = capture.seconds_since(self.first_capture);
        let (take, enough) = match self.mode {
            BackgroundMode::Instantaneous => (true, 1),
            BackgroundMode::Permanent { frames, every } => {
                ((self.arrived - 1).is_multiple_of(every.max(1)), frames.clamp(2, 255))
            }
            BackgroundMode::Live { bootstrap_s } => {
                // Evenly over the time, whatever the frame rate; a slow camera makes do with two.
                let spacing_s = bootstrap_s / (LIVE_FRAMES - 1) as f64;
                let due = self.stack.is_empty() || capture.seconds_since(self.last_taken) > 0.8 * spacing_s;
                let enough = if elapsed_s >= bootstrap_s - 0.5 * spacing_s { 2 } else { LIVE_FRAMES };
                (due, enough)
            }
        };
        if take {
            self.stack.push(picture.to_vec());
            self.last_taken = capture;
        }
        if self.stack.len() >= enough {
            self.settle(valid);
        }
        self.ready
    }

    /// Median and noise of the collected frames.
    fn settle(&mut self, valid: &[u8]) {
        let n = self.stack.len();
        let mut median = vec![0; self.level.len()];
        kernel::median(&self.stack.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut median);
        for (b, &m) in self.level.iter_mut().zip(&median) {
            *b = u16::from(m) << 8;
        }
        let kept = self.kept_for_revisions();
        // Deviations, taking the place of the frames.
        for frame in &mut self.stack {
            for (c, &m) in frame.iter_mut().zip(&median) {
                *c = c.abs_diff(m);
            }
        }
        let pooled = if n > 2 { mean_of_typical_pixels(&self.stack, valid) } else { 1.0 };
        for (i, noise) in self.noise.iter_mut().enumerate() {
            // Few frames say little about one pixel: half its own voice, half that of all, and never less than all say
            // together, for a pixel that happened to be quiet would be loud later. Walkers must not raise it.
            let own = self.stack.iter().map(|f| f32::from(f[i])).sum::<f32>() / n as f32;
            let blended = (0.5 * (pooled + own)).clamp(pooled, 3.0 * pooled);
            *noise = ((blended * 256.0) as u16).min(self.most_noise);
        }
        self.stack = kept;
        self.seen.fill(BOOTSTRAP_SEEN);
        self.seen_second.fill(0);
        self.known.fill(0);
        self.any_known = false;
        self.ready = true;
    }

    /// Thinks a young background over, now and then, half of its rows at a time: another look than the background's that a pixel has
    /// shown in more frames since the first takes its place. `same_light`: whether levels of then and now may be compared;
    /// once they may not, that is over.
    pub(super) fn revise(&mut self, picture: &[u8], capture: Timestamp, same_light: bool) {
        if !self.ready || self.stack.is_empty() {
            return;
        }
        let age_s = capture.seconds_since(self.first_capture);
        if !same_light || !(0.0..REVISED_FOR_S).contains(&age_s) || self.stack.len() >= self.most_revised() {
            self.stack = Vec::new();
            return;
        }
        let spacing_s = self.revision_spacing_s();
        let since_s = capture.seconds_since(self.last_taken);
        if since_s < 0.9 * spacing_s {
            return;
        }
        self.stack.push(picture.to_vec());
        // In step with the spacing, whatever the frame rate.
        self.last_taken = if since_s < 1.5 * spacing_s { self.last_taken.offset_by_secs(spacing_s) } else { capture };
        if self.stack.len() < LEAST_REVISED {
            return;
        }
        let half = (self.level.len() / self.width).div_ceil(2) * self.width;
        let pixels = if self.stack.len().is_multiple_of(2) { half..self.level.len() } else { 0..half };
        let frames: Vec<&[u8]> = self.stack.iter().map(|frame| &frame[pixels.clone()]).collect();
        let mut found = Vec::new();
        kernel::more_often_seen(&frames, &self.level[pixels.clone()], &self.noise[pixels.clone()], &mut found);
        for (i, look, frames) in found {
            self.replace(pixels.start + i, look);
            let pairs = (f64::from(frames) * spacing_s / PAIR_S).round() as u8;
            self.seen[pixels.start + i] = pairs.max(BOOTSTRAP_SEEN);
        }
    }

    /// Frames that are kept for second thoughts at most: fewer of large pictures, and none where these would be too few.
    fn most_revised(&self) -> usize {
        (REVISED_BYTES / self.level.len().max(1)).min(kernel::MOST_FRAMES)
    }

    /// Seconds from one of them to the next.
    fn revision_spacing_s(&self) -> f64 {
        REVISED_FOR_S / self.most_revised() as f64
    }

    /// Those of the bootstrap, as far apart as the ones that come later.
    fn kept_for_revisions(&self) -> Vec<Vec<u8>> {
        if !matches!(self.mode, BackgroundMode::Live { .. }) || self.most_revised() <= LEAST_REVISED {
            return Vec::new();
        }
        let between = (self.stack.len() - 1).max(1) as f64;
        let each_s = self.last_taken.seconds_since(self.first_capture) / between;
        let step = (self.revision_spacing_s() / each_s.max(1e-3)).round().clamp(1.0, LIVE_FRAMES as f64) as usize;
        self.stack.iter().step_by(step).cloned().collect()
    }

    /// Where the mark of pixel `i` is in `known`: its word, and the bit.
    fn known_bit(&self, i: usize) -> (usize, u64) {
        let (row, column) = (i / self.width, i % self.width);
        (row * self.stride + column / WORD, 1 << (column % WORD))
    }

    /// Another look is the background of pixel `i`; what was is forgotten.
    fn replace(&mut self, i: usize, level: u16) {
        self.level[i] = level;
        if let Some(seen_second) = self.seen_second.get_mut(i) {
            *seen_second = 0;
            let (word, bit) = self.known_bit(i);
            self.known[word] &= !bit;
        }
    }

    /// Fetches some pixels of a row into the cache, as far as it is one.
    pub(super) fn fetch(&self, y: usize, run: &Run) {
        let pixels = run.pixels(y, self.width);
        for levels in [&self.level, &self.noise] {
            if let Some(levels) = levels.get(pixels.clone()) {
                kernel::fetch(levels);
            }
        }
    }

    /// The same of how often looks were seen.
    pub(super) fn fetch_seen(&self, y: usize, run: &Run) {
        if let Some(seen) = self.seen.get(run.pixels(y, self.width)) {
            kernel::fetch(seen);
        }
    }

    /// The running average outside objects of some pixels of a row; nothing in permanent mode. `picture` and `how` (see
    /// [`kernel::learn`]) are whole pictures.
    pub(super) fn learn(&mut self, seen: Learnt<'_>, y: usize, run: &Run, rate: LearningRate) {
        if !self.ready || matches!(self.mode, BackgroundMode::Permanent { .. }) {
            return;
        }
        let LearningRate { shift, small_step } = rate;
        let pixels = run.pixels(y, self.width);
        let (level, noise) = (&mut self.level[pixels.clone()], &mut self.noise[pixels.clone()]);
        let (picture, how) = (&seen.picture[pixels.clone()], &seen.how[pixels]);
        kernel::learn(picture, seen.exposure_q15, how, shift, shift + 1, small_step, self.most_noise, level, noise);
    }

    /// Counts which of its looks some pixels of a row show, for `weight` pairs of frames; nothing but in the live mode. `round`
    /// counts how often all pixels had their turn.
    pub(super) fn count(&mut self, seen: Learnt<'_>, y: usize, run: &Run, round: usize, weight: u8) {
        if !self.ready || self.second.is_empty() {
            return;
        }
        // Where somebody is followed time goes slower: whoever stops stays an object, a ghost that is taken for somebody still goes.
        let also_kept = (round / 2).is_multiple_of(KEPT_SLOWNESS);
        let counting = kernel::Counting { also_kept, most: MOST_SEEN, lead: LEAD, weight };
        let pixels = run.pixels(y, self.width);
        let mut looks = kernel::Looks {
            level: &mut self.level[pixels.clone()],
            second: &mut self.second[pixels.clone()],
            seen: &mut self.seen[pixels.clone()],
            seen_second: &mut self.seen_second[pixels.clone()],
            known: &mut self.known[run.marks(y, self.stride)],
        };
        let (picture, how) = (&seen.picture[pixels.clone()], &seen.how[pixels.clone()]);
        self.any_known |=
            kernel::count_looks(picture, seen.exposure_q15, how, &self.noise[pixels], counting, &mut looks);
    }

    /// The light has changed by a factor, and stays so: all looks are as bright as that.
    pub(super) fn relight(&mut self, factor: f64) {
        let factor_q13 = (factor.clamp(0.25, 4.0) * 8192.0).round() as u32;
        for levels in [&mut self.level, &mut self.second] {
            for level in levels.iter_mut() {
                *level = ((u32::from(*level) * factor_q13) >> 13).min(255 << 8) as u16;
            }
        }
        for noise in &mut self.noise {
            *noise = ((u32::from(*noise) * factor_q13) >> 13).min(u32::from(self.most_noise)) as u16;
        }
    }

    /// Takes away the marks of a run of some rows (at most 32) where the picture shows what was the background before.
    pub(super) fn forgive_known(
        &self,
        picture: &[u8],
        exposure_q15: u16,
        rows: Range<usize>,
        run: &Run,
        faint: &mut Marks,
        strong: &mut Marks,
    ) {
        if !self.any_known {
            return;
        }
        let mut found = rows_with_known(&self.known, faint.words(), self.stride, rows.clone(), &run.words);
        while found != 0 {
            let y = rows.start + found.trailing_zeros() as usize;
            found &= found - 1;
            for (w, at) in run.words.clone().zip(run.marks(y, self.stride)) {
                let known = self.known[at];
                if !shows_known(known, faint.words()[at]) {
                    continue;
                }
                let pixels = y * self.width + w * WORD..y * self.width + ((w + 1) * WORD).min(run.columns.end);
                let layers = kernel::Layers { second: &self.second[pixels.clone()], known };
                let forgiven = kernel::known_look(&picture[pixels.clone()], exposure_q15, &self.noise[pixels], layers);
                faint.words_mut()[at] &= !forgiven;
                strong.words_mut()[at] &= !forgiven;
            }
        }
    }

    /// Take the gray level of pixel `i`: what stood there has left. What was the background for long stays known: what was taken
    /// for its ghost was a shadow then, and goes again.
    pub(super) fn absorb(&mut self, i: usize, gray: u8) {
        let level = u16::from(gray) << 8;
        // Nor does who has left come back by second thoughts.
        let left = (self.level[i] >> 8) as u8;
        for shown in
            self.stack.iter_mut().map(|frame| &mut frame[i]).filter(|shown| shown.abs_diff(left) <= kernel::ALIKE[1])
        {
            *shown = gray;
        }
        let Some(seen) = self.seen.get_mut(i) else {
            self.level[i] = level;
            return;
        };
        let long = *seen >= LONG_SEEN;
        *seen = (*seen).max(GHOST_SEEN);
        if long {
            (self.second[i], self.seen_second[i]) = (self.level[i], LONG_SEEN);
            let (word, bit) = self.known_bit(i);
            self.known[word] |= bit;
            self.any_known = true;
            self.level[i] = level;
        } else {
            self.replace(i, level);
        }
    }
}

/// For how long a background is thought over, seconds from its first frame; bytes of the frames that are kept for that, and from
/// how many frames on they tell more than a bootstrap.
const REVISED_FOR_S: f64 = 6.0;
const REVISED_BYTES: usize = 32 << 20;
const LEAST_REVISED: usize = 7;
/// Marks of a word among known pixels that are noise.
const FEW_KNOWN: u32 = 6;
/// A pair of frames as counts mean it, seconds.
const PAIR_S: f64 = 0.2;
/// What a bootstrap counts for, in pairs of frames as all counts here: something else that stays for a second replaces it.
const BOOTSTRAP_SEEN: u8 = 3;
/// What a background counts for that was found by removing a ghost.
const GHOST_SEEN: u8 = 10;
/// Most pairs counted: half a minute at 10 Hz.
const MOST_SEEN: u8 = 150;
/// What was background for so many pairs, 15 s, was no ghost.
const LONG_SEEN: u8 = 75;
/// Pairs by which the second look must have been seen longer.
const LEAD: u8 = 2;

/// Pairs count once in so many where somebody is followed.
const KEPT_SLOWNESS: usize = 3;

/// What a background learns from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Learnt<'a> {
    /// Grey levels.
    pub(super) picture: &'a [u8],
    /// Factor that brings the picture to the background's exposure; 32768 is 1.
    pub(super) exposure_q15: u16,
    /// How each pixel is learnt.
    pub(super) how: &'a [u8],
}

/// How fast a background follows, a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LearningRate {
    /// Of the level: 1/2^shift; the noise takes half of that.
    pub shift: u32,
    /// Largest step under unknown moving things, 1/256 grey levels.
    pub small_step: u8,
}

impl LearningRate {
    /// The same speed in time at any frame rate: `shift_at_10_hz` for frames 0.1 s apart.
    pub fn for_spacing(shift_at_10_hz: u32, spacing_s: f64) -> Self {
        let halvings = (0.1 / spacing_s.clamp(0.005, 10.0)).log2().round() as i32;
        let shift = (shift_at_10_hz as i32 + halvings).clamp(1, 8) as u32;
        Self { shift, small_step: (120.0 * spacing_s).round().clamp(1.0, 64.0) as u8 }
    }

    /// Where a cell is visited now and then: not so fast that the background takes over the noise of single frames.
    pub(super) fn for_visits(shift_at_10_hz: u32, spacing_s: f64) -> Self {
        let rate = Self::for_spacing(shift_at_10_hz, spacing_s);
        Self { shift: rate.shift.max(VISIT_SHIFT.min(shift_at_10_hz)), ..rate }
    }
}

/// An eighth of each visit.
const VISIT_SHIFT: u32 = 3;

/// Mean absolute deviation over the quieter 80 % of the pixels, made up for those left out being the louder ones.
fn mean_of_typical_pixels(deviations: &[Vec<u8>], valid: &[u8]) -> f32 {
    let n = deviations.len();
    let of_all = |i: usize| deviations.iter().map(|f| u32::from(f[i])).sum();
    let mut sums: Vec<u32> = (0..deviations[0].len()).filter(|i| valid[*i] != 0).map(of_all).collect();
    let keep = sums.len() * 4 / 5;
    if keep == 0 {
        return 1.0;
    }
    sums.select_nth_unstable(keep);
    let total: u64 = sums[..keep].iter().map(|&s| u64::from(s)).sum();
    // For the mean of nine half-normal deviations the quieter 80 % have 0.9 of the mean of all.
    (total as f32 / (keep * n) as f32 / 0.9).max(0.25)
}

/// Whether a word has more marks among known pixels than noise makes.
#[inline(always)]
fn shows_known(known: u64, marks: u64) -> bool {
    (known & marks).count_ones() >= FEW_KNOWN
}

kernel::wide! {
/// In which of some rows (bit 0 is the first) a word [`shows_known`] pixels.
fn rows_with_known(known: &[u64], marks: &[u64], stride: usize, rows: Range<usize>, words: &Range<usize>) -> u32 {
    let mut found = 0;
    for (k, y) in rows.enumerate() {
        let at = y * stride + words.start..y * stride + words.end;
        let many = known[at.clone()].iter().zip(&marks[at]).any(|(known, marks)| shows_known(*known, *marks));
        found |= u32::from(many) << k;
    }
    found
}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::golden;

    fn row_of(width: usize) -> Raster {
        Raster { width, height: 1, wraps: false }
    }

    fn at(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    #[test]
    fn the_permanent_background_is_the_golden_median() {
        let golden = golden("median");
        for (sequence, want) in
            golden["inputs"]["seqs"].as_array().unwrap().iter().zip(golden["outputs"].as_array().unwrap())
        {
            let values: Vec<u8> = sequence.as_array().unwrap().iter().map(|v| v.as_u64().unwrap() as u8).collect();
            if values.len() < 2 {
                continue;
            }
            let mut background =
                Background::new(BackgroundMode::Permanent { frames: values.len(), every: 1 }, row_of(3));
            let mut ready = false;
            for (i, v) in values.iter().enumerate() {
                assert!(!ready);
                ready = background.collect(&[*v; 3], &[1; 3], at(i as f64));
            }
            assert!(ready);
            assert_eq!(u64::from(background.levels()[0]), want.as_u64().unwrap());
        }
    }

    #[test]
    fn the_running_average_follows_the_golden_steps_in_fixed_point() {
        let golden = golden("bg_update");
        let mut background = Background::new(BackgroundMode::Instantaneous, row_of(2));
        background.collect(&[100, 100], &[1; 2], at(0.0));
        for want in golden["outputs"].as_array().unwrap() {
            let seen = Learnt { picture: &[140, 140], exposure_q15: 32768, how: &[kernel::LEARN, kernel::KEEP] };
            background.learn(seen, 0, &Run { words: 0..1, columns: 0..2 }, LearningRate::for_spacing(4, 0.1));
            assert_eq!(u64::from(background.level[0]), want.as_u64().unwrap());
            assert_eq!(background.level[1], 25600, "object pixels are not learnt");
        }
    }

    /// A background in front of which somebody (30) stood in the frames of the bootstrap and others in other clothes until `left_s`,
    /// before a wall (150), at some frame rate until `until_s`; it learns nothing but by second thoughts.
    fn thought_over(left_s: f64, until_s: f64, rate_hz: f64, same_light: bool) -> Background {
        let raster = Raster { width: 70, height: 3, wraps: false };
        let mut background = Background::new(BackgroundMode::Live { bootstrap_s: 0.8 }, raster);
        for frame in 0..(rate_hz * until_s).round() as u32 {
            let s = f64::from(frame) / rate_hz;
            let passing = 40 + ((10.0 * s).round() as u32 * 37 % 100) as u8;
            let shown = match s {
                _ if s < 0.85 => 30,
                _ if s < left_s => passing,
                _ => 150,
            };
            let picture = vec![shown; raster.len()];
            if background.is_ready() {
                background.revise(&picture, at(100.0 + s), same_light);
            } else {
                background.collect(&picture, &[1; 210], at(100.0 + s));
            }
        }
        background
    }

    #[test]
    fn a_crowd_before_a_robot_that_has_just_stopped_leaves_no_trace_once_the_wall_was_seen_for_longer() {
        for rate_hz in [5.0, 10.0, 25.0, 100.0] {
            let level = |left_s, until_s, same_light| {
                let levels = thought_over(left_s, until_s, rate_hz, same_light).levels();
                assert!(levels.iter().all(|level| *level == levels[0]), "{levels:?}");
                levels[0]
            };
            assert_eq!(level(2.0, 2.2, true), 30, "{rate_hz} Hz: nothing else was seen for long");
            assert_eq!(level(2.0, 3.9, true), 150, "{rate_hz} Hz");
            assert_eq!(level(2.0, 3.9, false), 30, "{rate_hz} Hz: levels of another light are not compared");
        }
        // Four pictures are no second thought: the background is still the middle of the bootstrap's two, 30 and 110.
        assert_eq!(thought_over(1.5, 4.0, 1.0, true).levels()[0], 70);
    }

    #[test]
    fn what_was_taken_for_a_trace_does_not_come_back_by_second_thoughts() {
        let mut background = thought_over(1.7, 1.8, 10.0, true);
        assert_eq!(background.levels()[0], 30);
        for i in 0..210 {
            background.absorb(i, 150);
        }
        for frame in 18..60 {
            background.revise(&[150; 210], at(100.0 + 0.1 * f64::from(frame)), true);
            assert!(background.levels().iter().all(|level| *level == 150), "frame {frame}");
        }
    }

    #[test]
    fn second_thoughts_hold_a_bounded_part_of_the_first_seconds() {
        for rate_hz in [10.0, 100.0] {
            let frames = thought_over(2.0, 5.7, rate_hz, true).stack.len();
            assert!((20..=kernel::MOST_FRAMES).contains(&frames), "{rate_hz} Hz: {frames}");
            assert!(thought_over(2.0, 7.0, rate_hz, true).stack.is_empty());
        }
        let of = |width, height| {
            Background::new(BackgroundMode::Live { bootstrap_s: 0.8 }, Raster { width, height, wraps: true })
        };
        // Of large pictures fewer frames are kept: 11 of 2.8 million pixels, none of twelve.
        assert_eq!((of(1080, 162).most_revised(), of(4320, 648).most_revised()), (kernel::MOST_FRAMES, 11));
        assert!(of(4096, 3072).most_revised() <= LEAST_REVISED);
    }

    #[test]
    fn a_relit_background_is_what_the_camera_sees_in_that_light() {
        let mut background = Background::new(BackgroundMode::Instantaneous, row_of(3));
        background.collect(&[40, 100, 240], &[1; 3], at(0.0));
        background.relight(0.5);
        assert_eq!(background.levels(), [20, 50, 120]);
        background.relight(4.0);
        assert_eq!(background.levels(), [80, 200, 255]);
    }

    #[test]
    fn a_live_background_is_there_within_a_second_from_two_frames_a_second_on() {
        for rate_hz in [2.0, 5.0, 10.0, 25.0, 100.0] {
            let mut background = Background::new(BackgroundMode::Live { bootstrap_s: 0.8 }, row_of(4));
            let mut i = 0;
            while !background.collect(&[9; 4], &[1; 4], at(f64::from(i) / rate_hz)) {
                i += 1;
            }
            assert!(f64::from(i) / rate_hz <= 1.0, "{rate_hz} Hz: frame {i}");
            assert_eq!(background.levels(), [9; 4]);
        }
    }
}
