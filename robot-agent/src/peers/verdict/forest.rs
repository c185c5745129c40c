//! Boosted decision trees: a sum of what each of them says.

/// A node of a tree: (trait, least value of the second branch, nats, branches). A leaf's branches are 0, where the root is. The nats of an
/// inner node are what would be said if it were a leaf.
pub type Node = (u8, f32, f32, [u16; 2]);

/// Nodes, the root first, branches after what they branch from.
pub(super) type Tree = &'static [Node];

/// The nodes of a tree on the way of these traits. A trait that is no number goes the first way.
fn path<'a>(tree: &'a [Node], traits: &'a [f64]) -> impl Iterator<Item = &'a Node> {
    std::iter::successors(tree.first(), |(of, least, _, branches)| {
        let value = traits.get(usize::from(*of)).copied().unwrap_or(f64::NAN) as f32;
        let next = branches[usize::from(value >= *least)];
        if next == 0 { None } else { tree.get(usize::from(next)) }
    })
}

/// What trees say together of something with these traits.
pub fn log_odds<T: AsRef<[Node]>>(trees: &[T], traits: &[f64]) -> f64 {
    let leaf = |tree: &T| path(tree.as_ref(), traits).last().map_or(0.0, |(_, _, nats, _)| f64::from(*nats));
    trees.iter().map(leaf).sum()
}

/// How much of that each trait has brought about where it was asked.
pub(super) fn terms(trees: &[Tree], traits: &[f64]) -> Vec<f64> {
    let mut said = vec![0.0; traits.len()];
    for tree in trees {
        let way: Vec<&Node> = path(tree, traits).collect();
        for pair in way.windows(2) {
            let ((of, _, before, _), (_, _, after, _)) = (pair[0], pair[1]);
            if let Some(said) = said.get_mut(usize::from(*of)) {
                *said += f64::from(after - before);
            }
        }
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    static TWO: &[Tree] = &[
        &[
            (1, 0.5, 0.1, [1, 2]),
            (0, 0.0, -1.0, [0, 0]),
            (0, 3.0, 0.4, [3, 4]),
            (0, 0.0, 0.2, [0, 0]),
            (0, 0.0, 2.0, [0, 0]),
        ],
        &[(0, 0.0, 0.25, [0, 0])],
    ];

    #[test]
    fn trees_are_walked_to_their_leaves_and_say_which_trait_took_them_there() {
        assert!((log_odds(TWO, &[9.0, 0.0]) + 0.75).abs() < 1e-6);
        assert!((log_odds(TWO, &[2.0, 0.5]) - 0.45).abs() < 1e-6);
        assert!((log_odds(TWO, &[3.0, 0.5]) - 2.25).abs() < 1e-6);
        let said = terms(TWO, &[3.0, 0.5]);
        assert!((said[1] - 0.3).abs() < 1e-6 && (said[0] - 1.6).abs() < 1e-6, "{said:?}");
        assert!((log_odds(TWO, &[f64::NAN, f64::NAN]) + 0.75).abs() < 1e-6);
    }
}
