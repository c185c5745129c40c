//! Identity switches as in CLEAR-MOT (Bernardin and Stiefelhagen, 2008).
//!
//! A pair of the instant before stays matched while it is inside the gate; only what is left is assigned anew. A switch is a
//! person matched to another target than the last one it was matched to, however long ago that was.

use protocol::id::TargetId;

use super::assignment::assign;

/// Counts switches over the instants of a run.
#[derive(Debug, Clone, Default)]
pub struct IdentityCount {
    /// A person each: the last target, and whether the pair stood at the last instant.
    last: Vec<Option<(TargetId, bool)>>,
    switches: usize,
}

impl IdentityCount {
    /// One instant: `distances_m[person][target]`, the same people in the same order every time. Returns the people who
    /// switched.
    pub fn add(&mut self, distances_m: &[Vec<f64>], targets: &[TargetId], gate_m: f64) -> Vec<usize> {
        self.last.resize(self.last.len().max(distances_m.len()), None);
        let mut free = distances_m.to_vec();
        let mut matched = vec![None; distances_m.len()];
        for (person, last) in self.last.iter().enumerate() {
            let Some((target, true)) = last else { continue };
            let Some(column) = targets.iter().position(|t| t == target) else { continue };
            if free[person][column] < gate_m {
                matched[person] = Some(column);
                free[person].fill(f64::INFINITY);
                for row in &mut free {
                    row[column] = f64::INFINITY;
                }
            }
        }
        for (person, column) in assign(&free, gate_m).into_iter().enumerate() {
            matched[person] = matched[person].or(column);
        }
        let mut switched = Vec::new();
        for (person, column) in matched.into_iter().enumerate() {
            match column.map(|column| targets[column]) {
                Some(target) => {
                    if self.last[person].is_some_and(|(before, _)| before != target) {
                        switched.push(person);
                    }
                    self.last[person] = Some((target, true));
                }
                None => self.last[person] = self.last[person].map(|(target, _)| (target, false)),
            }
        }
        self.switches += switched.len();
        switched
    }

    /// All switches so far.
    pub fn switches(&self) -> usize {
        self.switches
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: TargetId = TargetId(1);
    const B: TargetId = TargetId(2);

    #[test]
    fn a_pair_stays_while_it_is_inside_the_gate_even_where_another_target_is_nearer() {
        let mut count = IdentityCount::default();
        count.add(&[vec![0.1, 0.9], vec![0.9, 0.1]], &[A, B], 0.5);
        count.add(&[vec![0.4, 0.1], vec![0.1, 0.4]], &[A, B], 0.5);
        assert_eq!(count.switches(), 0);
    }

    #[test]
    fn two_targets_that_change_places_are_two_switches() {
        let mut count = IdentityCount::default();
        count.add(&[vec![0.1, 2.0], vec![2.0, 0.1]], &[A, B], 0.5);
        assert_eq!(count.add(&[vec![2.0, 0.1], vec![0.1, 2.0]], &[A, B], 0.5), [0, 1]);
        assert_eq!(count.switches(), 2);
    }

    #[test]
    fn a_new_target_after_a_gap_is_a_switch_and_the_old_one_is_not() {
        let mut count = IdentityCount::default();
        count.add(&[vec![0.1]], &[A], 0.5);
        count.add(&[vec![]], &[], 0.5);
        count.add(&[vec![0.1]], &[A], 0.5);
        assert_eq!(count.switches(), 0);
        count.add(&[vec![]], &[], 0.5);
        count.add(&[vec![0.1]], &[B], 0.5);
        assert_eq!(count.switches(), 1);
    }
}
