//! Pictures that are none: black, saturated, frozen.

use protocol::time::Timestamp;

use super::{gain, kernel};

/// A camera's noise makes every picture another one: the same one for so long, and so often, is an old one.
const FROZEN_S: f64 = 2.0;
const FROZEN_FRAMES: u32 = 8;

/// All black or all white is no picture. Looks at a sparse sample.
pub(super) fn failure(picture: &[u8], valid: &[u8]) -> Option<&'static str> {
    let (mut n, mut dark, mut bright) = (0, 0, 0);
    for run in gain::sample(picture.len()) {
        let [tested, black, white] = kernel::count_extremes(&picture[run.clone()], &valid[run]);
        (n, dark, bright) = (n + tested, dark + black, bright + white);
    }
    if n > 0 && 100 * dark >= 98 * n {
        Some("the picture is black")
    } else if n > 0 && 100 * bright >= 98 * n {
        Some("the picture is saturated")
    } else {
        None
    }
}

/// Since when the picture is the same.
#[derive(Debug, Default)]
pub(super) struct Frozen {
    since: Option<Timestamp>,
    frames: u32,
}

impl Frozen {
    /// Whether a picture is the same as the one before; says once that they have long been the same.
    pub(super) fn look(&mut self, is_same: bool, capture: Timestamp) -> Option<&'static str> {
        if !is_same {
            *self = Self::default();
            return None;
        }
        let since = *self.since.get_or_insert(capture);
        let was = self.frames;
        // Counted until it is said; then it has been said.
        if was < FROZEN_FRAMES {
            self.frames += 1;
        }
        let now = was == FROZEN_FRAMES && capture.seconds_since(since) >= FROZEN_S;
        if now {
            self.frames += 1;
        }
        now.then_some("the picture is frozen")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_stays_the_same_is_said_once_and_again_after_it_moved() {
        let mut frozen = Frozen::default();
        let mut said = Vec::new();
        for n in 0..200u64 {
            let before = vec![7u8; 10];
            let picture = if n % 100 == 50 { vec![8; 10] } else { before.clone() };
            if frozen.look(picture == before, Timestamp(n * 100_000_000)).is_some() {
                said.push(n);
            }
        }
        assert_eq!(said, [20, 71, 171]);
        // Two pictures that are the same are a slow camera's.
        let mut slow = Frozen::default();
        assert!((0..5u64).all(|n| slow.look(true, Timestamp(n * 10_000_000_000)).is_none()));
    }

    #[test]
    fn a_picture_that_is_black_now_and_then_is_one_failure() {
        use crate::motion::{MotionSettings, MotionStage, Raster};
        let raster = Raster { width: 64, height: 48, wraps: false };
        let settings = MotionSettings { own_motion: false, ..MotionSettings::default() };
        let mut stage = MotionStage::new(raster, None, settings).unwrap();
        let room: Vec<u8> = (0..raster.len()).map(|i| 60 + (i * 7 % 90) as u8).collect();
        let black = vec![0; raster.len()];
        let mut failures = Vec::new();
        for n in 0..200_u64 {
            let bad = (20..80).contains(&n) && n.is_multiple_of(2) || n == 150;
            let picture = if bad { &black } else { &room };
            let change = stage.change(picture, Timestamp(1 + n * 100_000_000)).unwrap();
            if let Some(protocol::message::AlarmKind::SensorFailure(why)) = change.alarm
                && why.contains("black")
            {
                failures.push(n);
            }
        }
        assert_eq!(failures, [20, 150]);
    }
}
