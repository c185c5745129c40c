//! The light's common factor: automatic exposure, a cloud, a lamp that flickers change the whole picture by one ratio.
//!
//! The median of C/B over a sparse sample is that ratio as long as objects cover less than half of the picture; dividing
//! it out keeps a camera that re-exposes for a passing truck from seeing objects everywhere.

use std::ops::Range;

use protocol::time::Timestamp;

use super::kernel;

/// Largest correction at once, as a factor up or down; what is beyond is an event, not exposure.
const LIMIT: f64 = 1.3;
/// Largest change from one frame to the next of a correction that has grown beyond it: dusk, a slow exposure.
const DRIFT: f64 = 1.08;
/// Farther from the background's light it has no meaning.
const MOST_DRIFT: f64 = 1.9;
/// The sample: so many runs of so many pixels. Runs are cheap to read, and many enough to be everywhere.
const RUNS: usize = 128;
const RUN: usize = 16;
/// Darker pixels carry no ratio.
const MIN_LEVEL: u16 = 24 << 8;
/// One of so many tested pixels must carry one.
const LEAST_SHARE: u32 = 8;
/// Bins of the ratios' histogram for a ratio of 1; it reaches to 2.
const BINS: usize = 1024;

/// A sparse sample of `len` pixels: a run somewhere in each of equal parts, so that the runs are in all columns whatever the width.
pub(super) fn sample(len: usize) -> impl Iterator<Item = Range<usize>> {
    let part = (len / RUNS).max(RUN);
    (0..len / part).map(move |k| {
        // Weyl's sequence by the golden ratio.
        let share = (k as u32).wrapping_mul(0x9E37_79B1) as usize;
        let start = k * part + (share >> 8) % (part - RUN + 1);
        start..start + RUN
    })
}

/// Median of picture / background; 1 where nothing can be said. Levels are 8.8 fixed point; `valid` is 0 or 1. `before` is the gain
/// of the frame before.
pub(super) fn common_gain(picture: &[u8], background: &[u16], valid: &[u8], before: f64) -> f64 {
    let mut counts = [0u16; 2 * BINS];
    let (mut n, mut tested) = (0u32, 0u32);
    let mut bins = [0u16; RUN];
    for run in sample(picture.len()) {
        let bins = &mut bins[..run.len()];
        tested += valid[run.clone()].iter().map(|v| u32::from(*v)).sum::<u32>();
        kernel::ratio_bins(&picture[run.clone()], &background[run.clone()], &valid[run], MIN_LEVEL, BINS as u16, bins);
        for &bin in bins.iter().filter(|bin| **bin != u16::MAX) {
            counts[usize::from(bin)] += 1;
            n += 1;
        }
    }
    // A few lights at night do not speak for the rest.
    if n < 50 || n < tested / LEAST_SHARE {
        return 1.0;
    }
    // Within its bin the median is where the counts say.
    let half = f64::from(n) / 2.0;
    let mut below = 0.0;
    let bin = counts.iter().position(|&count| {
        below += f64::from(count);
        below >= half
    });
    let Some(bin) = bin else { return 1.0 };
    let count = f64::from(counts[bin]);
    let gain = (bin as f64 + (half - (below - count)) / count.max(1.0)) / BINS as f64;
    let within = |gain: f64, limit: f64| (1.0 / limit..=limit).contains(&gain);
    if within(gain, LIMIT) || within(gain / before, DRIFT) && within(gain, MOST_DRIFT) { gain } else { 1.0 }
}

/// Since when the light has been clearly another than the background's: dusk goes on, an exposure comes back.
#[derive(Debug, Default)]
pub(super) struct Light {
    other_since: Option<Timestamp>,
}

impl Light {
    /// Takes the gain of a frame; whether the background should take over this light.
    pub(super) fn stays(&mut self, gain: f64, capture: Timestamp) -> bool {
        if (1.0 / OTHER_LIGHT..=OTHER_LIGHT).contains(&gain) {
            self.other_since = None;
            return false;
        }
        let since = *self.other_since.get_or_insert(capture);
        let stays = capture.seconds_since(since) >= STAYS_S;
        if stays {
            self.other_since = None;
        }
        stays
    }
}

/// Another light than the background's …
const OTHER_LIGHT: f64 = 1.25;
/// … that has stayed for so long, seconds.
const STAYS_S: f64 = 1.5;

/// Factor that brings a picture back to the background's exposure, as [`super::kernel::expose`] takes it (Q15).
pub(super) fn inverse_q15(gain: f64) -> u16 {
    (32768.0 / gain).round().clamp(1.0, 65535.0) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_found_beside_objects_that_cover_a_third() {
        let background: Vec<u16> = (0..30_000u32).map(|i| ((60 + i % 120) << 8) as u16).collect();
        let picture: Vec<u8> = background
            .iter()
            .enumerate()
            .map(|(i, b)| if i < 10_000 { 200 } else { (f64::from(b >> 8) * 1.1).round() as u8 })
            .collect();
        let gain = common_gain(&picture, &background, &vec![1; 30_000], 1.0);
        assert!((gain - 1.1).abs() < 0.02, "{gain}");
    }

    #[test]
    fn the_sample_is_in_all_columns_of_pictures_of_every_size() {
        for (width, height) in
            [(512, 384), (768, 576), (1024, 768), (1280, 1024), (4096, 3072), (1080, 162), (720, 108)]
        {
            let mut eighths = [0; 8];
            for run in sample(width * height) {
                assert!(run.end <= width * height);
                eighths[run.start % width * 8 / width] += 1;
            }
            assert!(eighths.iter().all(|n| (8..=24).contains(n)), "{width}x{height}: {eighths:?}");
        }
        assert_eq!(sample(100).last(), Some(80..96));
    }

    #[test]
    fn lights_in_the_night_say_nothing_of_the_rest() {
        let background: Vec<u16> = (0..30_000usize).map(|i| if i % 150 < 10 { 80 << 8 } else { 8 << 8 }).collect();
        let picture: Vec<u8> = background.iter().map(|b| if *b > 24 << 8 { 100 } else { 8 }).collect();
        assert_eq!(common_gain(&picture, &background, &vec![1; 30_000], 1.0), 1.0);
    }

    #[test]
    fn the_background_takes_over_a_light_that_stays_and_none_that_passes() {
        let at = |s: f64| Timestamp::from_secs_f64(s);
        let mut light = Light::default();
        let passing = (0..30).any(|i| light.stays(if i % 10 < 8 { 0.7 } else { 1.0 }, at(0.1 * f64::from(i))));
        assert!(!passing);
        let mut light = Light::default();
        assert!((0..15).all(|i| !light.stays(0.7, at(0.1 * f64::from(i)))) && light.stays(0.7, at(1.6)));
    }

    #[test]
    fn a_room_in_which_it_grows_dark_stays_known() {
        use rand::{Rng, SeedableRng};

        use crate::motion::{Holds, MotionSettings, MotionStage, Raster};
        let raster = Raster { width: 160, height: 60, wraps: true };
        let mut stage = MotionStage::new(raster, None, MotionSettings::default()).unwrap();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut alarms = Vec::new();
        for frame in 0..350 {
            let time_s = 0.1 * f64::from(frame);
            let light = 1.0 - (time_s - 4.0).clamp(0.0, 30.0) / 45.0; // to a third within 30 s
            let picture: Vec<u8> = (0..raster.len())
                .map(|i| {
                    let wall = 60.0 + 14.0 * ((i % 160) / 8 % 11) as f64;
                    let noise = (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 3.0;
                    (wall * light + noise).round().clamp(0.0, 255.0) as u8
                })
                .collect();
            alarms.extend(stage.change(&picture, Timestamp::from_secs_f64(1.0 + time_s)).unwrap().alarm);
            stage.extract();
            let objects = stage.scene().objects.len();
            assert_eq!(objects, 0, "objects at {time_s:.1} s");
            stage.learn(&Holds::default());
        }
        assert_eq!(alarms, [protocol::message::AlarmKind::BackgroundReady]);
    }

    #[test]
    fn a_light_that_fades_is_followed_and_one_that_is_switched_is_not() {
        let background: Vec<u16> = (0..30_000u32).map(|i| ((60 + i % 120) << 8) as u16).collect();
        let lit = |share: f64| -> Vec<u8> {
            background.iter().map(|b| (f64::from(*b) / 256.0 * share).round() as u8).collect()
        };
        let mut gain = 1.0;
        for step in 0..60 {
            let share = 1.0 - 0.0075 * f64::from(step);
            gain = common_gain(&lit(share), &background, &vec![1; 30_000], gain);
            assert!((gain / share - 1.0).abs() < 0.02, "{gain} at {share}");
        }
        assert_eq!(common_gain(&lit(0.55), &background, &vec![1; 30_000], 1.0), 1.0);
    }
}
