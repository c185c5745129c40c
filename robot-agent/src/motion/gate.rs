//! Two decisions by counting: does a region really move (change gate), and did the whole scene change (alarm).
//! `MATHS.md` §7.6 and §7.7; golden groups `gate` and `alarm`.

/// Whether a region of `area` pixels moves: `changed` of them differ from the frame before.
/// Keep iff changed ≥ max(4, ⌈0.05 · area⌉).
pub fn region_moves(area: usize, changed: usize) -> bool {
    changed >= least_changed(area)
}

/// How many pixels of a region that moves differ from the frame before at least.
pub(super) fn least_changed(area: usize) -> usize {
    area.div_ceil(20).max(4)
}

/// Whether more than half of the picture differs from the background (strictly).
pub fn scene_changed(valid: usize, differing: usize) -> bool {
    2 * differing > valid
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::golden;

    #[test]
    fn the_gate_follows_the_golden_table() {
        for case in golden("gate")["outputs"].as_array().unwrap() {
            let n = |k: &str| case[k].as_u64().unwrap() as usize;
            assert_eq!(region_moves(n("area"), n("changed")), case["accept"].as_bool().unwrap(), "{case}");
        }
    }

    #[test]
    fn the_alarm_follows_the_golden_table() {
        for case in golden("alarm")["outputs"].as_array().unwrap() {
            let n = |k: &str| case[k].as_u64().unwrap() as usize;
            assert_eq!(scene_changed(n("valid"), n("count")), case["alarm"].as_bool().unwrap(), "{case}");
        }
    }
}
