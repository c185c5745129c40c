//! What is promised of each case, and whether it was kept.

use serde::Serialize;

use super::score::{Errors, RECOVERY_FRAMES};
use super::{Case, Tally};

/// A promise.
#[derive(Debug, Clone, Serialize)]
pub struct Claim {
    /// In words.
    pub says: &'static str,
    /// What was found.
    pub found: String,
    /// Whether it was kept.
    pub kept: bool,
}

/// Least share of a stand of 20 s in which somebody must keep his track and its name.
const LEAST_HELD: f64 = 0.95;

/// The promises of a case.
pub fn claims(case: Case, tally: &Tally) -> Vec<Claim> {
    let mut claims = Vec::new();
    let mut claim = |says, found: String, kept| claims.push(Claim { says, found, kept });
    if case != Case::Light && case != Case::Turn {
        let seeds = format!("{} in {} trials, seeds {:?}", tally.switches, tally.trials, tally.switched_in);
        claim("no identity switch", seeds, tally.switches == 0);
    }
    let worst = |frames: &[Option<usize>]| frames.iter().map(|f| f.unwrap_or(usize::MAX)).max().unwrap_or(0);
    let show = |frames: usize| if frames == usize::MAX { "never".to_owned() } else { format!("{frames} at worst") };
    if case == Case::Light {
        let frames = worst(&tally.alarm_after);
        claim("alarm within one frame of the light", show(frames), frames <= 1);
    }
    if matches!(case, Case::Light | Case::Turn) {
        let frames = worst(&tally.recovery_after);
        claim("tracking again within 30 frames", show(frames), frames <= RECOVERY_FRAMES);
    }
    claim("no false alarm", tally.false_alarms.to_string(), tally.false_alarms == 0);
    if case == Case::Turn {
        let [frames, said, silent] = tally.turning;
        let found = format!("{said} of {frames} frames, {silent} said to stand");
        claim("a turning robot says so", found, 10 * said >= 7 * frames && 20 * silent <= frames);
    }
    if case == Case::Stand {
        let least = tally.held.first().copied().unwrap_or(0.0);
        claim("held under its name while standing", format!("{:.1} % at worst", 100.0 * least), least >= LEAST_HELD);
    }
    if !case.is_meeting() {
        let all = tally.all_ends();
        let mut nees = |says, errors: &Errors| {
            if let (Some(mean), Some([low, high])) = (errors.nees.mean(), errors.nees.bounds()) {
                claim(says, format!("{mean:.2} in {low:.2} … {high:.2}"), mean <= high);
            }
        };
        nees("bearings are as good as they say", &all.bearing);
        if case == Case::Approach {
            nees("ranges are", &all.range);
            nees("heights are", &all.height);
            nees("feet are", &all.elevation[0]);
            nees("tops are", &all.elevation[1]);
            let [bounds, broken] = all.bounds;
            claim("cut and hidden ends are bounds", format!("{broken} of {bounds} are not"), 100 * broken <= bounds);
        }
    }
    claims
}
