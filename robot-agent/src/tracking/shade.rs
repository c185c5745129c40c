//! Whether what differs from the background is only darker than it: a shadow that somebody casts on what is behind him.
//!
//! Problem: shadows on walls are smooth, and are taken away where they are marked (`motion/shadow`). On a sofa or on shelves the edge of
//! a shadow runs over many levels of grey, so that its ratio to the background is another one in each place, and what is left of it
//! is as large as somebody, stands beside somebody, and moves with him. Insight: light that is kept away changes slowly from place to
//! place, so the edges of what is behind stay where they were; a body covers them. So the steps from pixel to pixel are compared
//! where the background has any. Where it has few, a shadow is darker than what is behind in every pixel, and not by much; hair,
//! faces, shirts and trousers hardly ever are all so at once.

use crate::motion::{Region, Scene};

/// Least step of the background that is compared, grey levels in 8.8 fixed point: well above the noise of a picture.
const LEAST_STEP: u16 = 6 << 8;
/// Fewest steps that tell something.
const LEAST_STEPS: usize = 24;
/// A step counts for at most so much of the background's either way.
const MOST: f64 = 1.25;

/// What is left of the steps in what is no body but a shadow, and in one that its darkness must tell.
const SHADED: f64 = 0.6;
const DARK_SHADED: f64 = 0.3;
/// Picture over background in a shadow: of nearly all pixels, and the least that half of them have.
const DARKER: [f64; 2] = [0.35, 1.0];
const LEAST_DARKER: f64 = 0.95;
const LEAST_USUAL: f64 = 0.5;

/// How much speaks for a region's being a shadow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shaded {
    /// It is none.
    No,
    /// One body in a hundred would look so: it is darker all over than what is behind.
    Perhaps,
    /// What is behind shows through.
    Surely,
}

/// Whether a region is a shadow.
pub(super) fn shaded(region: &Region, scene: &Scene<'_>) -> Shaded {
    if scene.background.len() != scene.picture.len() {
        return Shaded::No;
    }
    match shade(region, scene) {
        Some(left) if left > SHADED => Shaded::Surely,
        Some(left) if left < DARK_SHADED => Shaded::No,
        _ if is_darker_all_over(region, scene) => Shaded::Perhaps,
        _ => Shaded::No,
    }
}

/// Whether it is darker than what is behind in nearly every pixel, and mostly not by much.
fn is_darker_all_over(region: &Region, scene: &Scene<'_>) -> bool {
    let (mut all, mut darker, mut usual) = (0u32, 0u32, 0u32);
    for (row, start, len) in region.spans() {
        let at = row * scene.raster.width + start;
        for (now, behind) in scene.picture[at..at + len].iter().zip(&scene.background[at..at + len]) {
            let ratio = 256.0 * f64::from(*now) / f64::from((*behind).max(1));
            all += 1;
            darker += u32::from(ratio > DARKER[0] && ratio < DARKER[1]);
            usual += u32::from(ratio > LEAST_USUAL);
        }
    }
    f64::from(darker) >= LEAST_DARKER * f64::from(all) && 2 * usual >= all
}

/// What is left in the picture of the background's steps inside a region: about 0 where a body covers it, its brightness in the shade where it
/// is shaded. `None` where the background is too smooth to tell.
fn shade(region: &Region, scene: &Scene<'_>) -> Option<f64> {
    let width = scene.raster.width;
    let (mut sum, mut steps) = (0.0, 0usize);
    for (row, start, len) in region.spans() {
        let first = row * width + start;
        for at in first..first + len {
            // To the pixel two on, in the same piece of the row, and to that two below, where somebody is.
            let others = [Some(at + 2).filter(|on| *on < first + len), Some(at + 2 * width)];
            let marked = |other: &usize| scene.mask.get(*other).is_some_and(|mask| *mask != 0);
            for other in others.into_iter().flatten().filter(marked) {
                let (here, there) = (scene.background[at], scene.background[other]);
                if here.abs_diff(there) < LEAST_STEP {
                    continue;
                }
                let behind = f64::from(there) - f64::from(here);
                let now = 256.0 * (f64::from(scene.picture[other]) - f64::from(scene.picture[at]));
                sum += (now / behind).clamp(-MOST, MOST);
                steps += 1;
            }
        }
    }
    (steps >= LEAST_STEPS).then(|| sum / steps as f64)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::motion::{Raster, group};

    const RING: Raster = Raster { width: 120, height: 60, wraps: true };

    /// What `judge` says of a region over the seam, of a background with a pattern of some strength; `now` of the background's level, column
    /// and row.
    fn judged<T>(pattern: f64, now: impl Fn(f64, usize, usize) -> f64, judge: impl Fn(&Region, &Scene<'_>) -> T) -> T {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let behind = |x: usize, y: usize| 130.0 + pattern * (x as f64 / 2.5).sin() * (y as f64 / 3.5).cos();
        let at = |i: usize| (i % RING.width, i / RING.width);
        let background: Vec<u16> = (0..RING.len()).map(|i| (256.0 * behind(at(i).0, at(i).1)) as u16).collect();
        let mask: Vec<u8> = (0..RING.len()).map(|i| u8::from((at(i).0 + 10) % 120 < 24 && at(i).1 > 12)).collect();
        let mut noise = || (0..4).map(|_| f64::from(rng.next_u32() >> 24) / 256.0 - 0.5).sum::<f64>() * 2.6;
        let picture: Vec<u8> = (0..RING.len())
            .map(|i| (now(behind(at(i).0, at(i).1), at(i).0, at(i).1) + noise()).clamp(0.0, 255.0) as u8)
            .collect();
        let scene = Scene { picture: &picture, background: &background, ..Scene::of_marks(&RING, &mask, &mask) };
        judge(&group(&mask, &RING, [1, 1], 1)[0], &scene)
    }

    fn left(pattern: f64, now: impl Fn(f64, usize, usize) -> f64) -> Option<f64> {
        judged(pattern, now, shade)
    }

    #[test]
    fn the_pattern_behind_is_left_in_a_shadow_however_soft_and_not_in_front_of_a_body() {
        for strength in [20.0, 50.0] {
            let soft = |level: f64, _: usize, y: usize| level * (0.95 - 0.006 * y as f64);
            let deep = |level: f64, _: usize, _: usize| 0.65 * level;
            for shadow in [&soft as &dyn Fn(f64, usize, usize) -> f64, &deep] {
                let left = left(strength, shadow).unwrap();
                assert!((0.6..1.0).contains(&left), "{left:.2} of {strength}");
            }
            let plain = |_: f64, _: usize, _: usize| 80.0;
            let checked = |_: f64, x: usize, y: usize| 80.0 + 30.0 * (x as f64 / 1.7).cos() * (y as f64 / 2.1).sin();
            for body in [&plain as &dyn Fn(f64, usize, usize) -> f64, &checked] {
                let left = left(strength, body).unwrap();
                assert!(left.abs() < 0.3, "{left:.2} of {strength}");
            }
        }
    }

    #[test]
    fn before_a_smooth_wall_it_may_be_a_shadow_where_all_of_it_is_a_little_darker() {
        assert_eq!(left(1.0, |level, _, _| 0.7 * level), None);
        let wall = |now: &dyn Fn(f64, usize, usize) -> f64| judged(1.0, now, shaded);
        let soft = |level: f64, x: usize, y: usize| level * (0.6 + 0.002 * x as f64 + 0.001 * y as f64);
        assert_eq!(wall(&|level, _, _| 0.7 * level), Shaded::Perhaps);
        assert_eq!(wall(&soft), Shaded::Perhaps);
        let coat = |_: f64, _: usize, _: usize| 35.0;
        let bright_shirt = |_: f64, _: usize, y: usize| if y < 30 { 170.0 } else { 80.0 };
        let checked = |_: f64, x: usize, y: usize| 115.0 + 30.0 * (x as f64 / 1.7).cos() * (y as f64 / 2.1).sin();
        for clothes in [&coat as &dyn Fn(f64, usize, usize) -> f64, &bright_shirt, &checked] {
            assert_eq!(wall(clothes), Shaded::No);
        }
        // Where something is behind that clothes cover, they are no shadow however dull.
        assert_eq!(judged(50.0, |_, _, _| 70.0, shaded), Shaded::No);
        assert_eq!(judged(50.0, |level, _, _| 0.65 * level, shaded), Shaded::Surely);
    }
}
