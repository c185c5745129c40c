//! The heaviest set of things of which no two exclude each other (weighted set packing), by branch and bound.
//!
//! Exponential at worst; with the heaviest first and few of them it ends soon, and after [`MAX_STEPS`] with the best set
//! found so far.

/// Most things: as many as a set of 64 bits holds, and fewer.
pub const MOST: usize = 48;
const MAX_STEPS: u32 = 4000;

/// Which things exclude which, as sets of bits; at most [`MOST`] things.
pub fn exclusions(things: usize, exclude: impl Fn(usize, usize) -> bool) -> Vec<u64> {
    let of = |k: usize| (0..things).filter(|other| exclude(k, *other)).fold(0, |set, other| set | 1 << other);
    (0..things).map(of).collect()
}

/// Weight and members of the best set; `weights` positive, heaviest first, at most [`MOST`]; only things that `allowed` says.
/// `exclude`: see [`exclusions`].
pub fn best(weights: &[f64], allowed: &dyn Fn(usize) -> bool, exclude: &[u64]) -> (f64, Vec<usize>) {
    let things: Vec<usize> = (0..weights.len()).filter(|k| allowed(*k)).collect();
    let mut search = Search { weights, things, exclude, best: (0.0, Vec::new()), steps: 0 };
    search.from(0, 0.0, 0, &mut Vec::new());
    search.best
}

struct Search<'a> {
    weights: &'a [f64],
    things: Vec<usize>,
    exclude: &'a [u64],
    best: (f64, Vec<usize>),
    steps: u32,
}

impl Search<'_> {
    /// `taken`: what the chosen ones exclude.
    fn from(&mut self, at: usize, weight: f64, taken: u64, chosen: &mut Vec<usize>) {
        if weight > self.best.0 {
            self.best = (weight, chosen.clone());
        }
        let rest = self.things.get(at..).unwrap_or_default();
        let free = |k: usize| taken & 1 << k == 0;
        let hope: f64 = rest.iter().filter(|k| free(**k)).map(|k| self.weights[*k]).sum();
        self.steps += 1;
        if rest.is_empty() || weight + hope <= self.best.0 || self.steps > MAX_STEPS {
            return;
        }
        let k = rest[0];
        if free(k) {
            chosen.push(k);
            self.from(at + 1, weight + self.weights[k], taken | self.exclude[k], chosen);
            chosen.pop();
        }
        self.from(at + 1, weight, taken, chosen);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_people_outweigh_the_ghost_that_takes_a_track_of_each() {
        // Ghost 0 shares a track with each of the real ones 1 and 2.
        let exclude = |a: usize, b: usize| a == 0 || b == 0;
        let exclude = exclusions(3, exclude);
        let (weight, chosen) = best(&[3.5, 3.0, 3.0], &|_| true, &exclude);
        assert_eq!((weight, chosen), (6.0, vec![1, 2]));
        assert_eq!(best(&[3.5, 3.0, 3.0], &|k| k != 2, &exclude).0, 3.5);
    }

    #[test]
    fn the_search_agrees_with_trying_every_set() {
        let weights = [5.0, 4.5, 4.0, 3.0, 2.5, 2.0, 1.0, 0.5];
        let exclude = |a: usize, b: usize| (a * 5 + b * 5 + a * b).is_multiple_of(3);
        let sets = (0u32..256).filter_map(|bits| {
            let set: Vec<usize> = (0..8).filter(|k| bits & (1 << k) != 0).collect();
            let possible = set.iter().all(|a| set.iter().all(|b| a >= b || !exclude(*b, *a)));
            possible.then(|| set.iter().map(|k| weights[*k]).sum::<f64>())
        });
        assert_eq!(best(&weights, &|_| true, &exclusions(8, exclude)).0, sets.fold(0.0, f64::max));
    }
}
