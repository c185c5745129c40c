//! Robots of which a part is hidden: by people, by other robots, by furniture.

use std::collections::BTreeMap;

use serde::Serialize;

use super::Outcome;
use super::statistics::{FOUR_SIGMA, distance2, shows};
use super::trial::Before;

/// Bounds of the bins of the unhidden share.
const SHARES: [f64; 4] = [0.25, 0.5, 0.75, 1.01];

/// Robots behind one kind of thing, of which a like share is to be seen.
#[derive(Debug, Clone, Serialize)]
pub struct Hidden {
    /// nothing, person, robot, furniture.
    pub before: &'static str,
    /// Unhidden share from … to.
    pub visible: [f64; 2],
    /// So many.
    pub shown: usize,
    /// Found of them.
    pub found: usize,
    /// Found, but more than 4 σ from where they are.
    pub beyond_four_sigma: usize,
    /// Mean of (error' C⁻¹ error) / 2 of those found.
    pub nees: f64,
}

impl Before {
    fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Person => "person",
            Self::Robot => "robot",
            Self::Thing => "furniture",
        }
    }
}

/// All kinds and shares that occur.
pub fn table(outcomes: &[Outcome]) -> Vec<Hidden> {
    let mut cells: BTreeMap<(Before, usize), Hidden> = BTreeMap::new();
    for (views, sightings) in outcomes.iter().flat_map(|o| o.views.iter().zip(&o.sightings)) {
        for (n, view) in views.iter().enumerate().filter(|(_, view)| shows(view)) {
            let Some(bin) = SHARES.windows(2).position(|b| (b[0]..b[1]).contains(&view.visible)) else { continue };
            let cell = cells.entry((view.before, bin)).or_insert_with(|| Hidden {
                before: view.before.name(),
                visible: [SHARES[bin], SHARES[bin + 1].min(1.0)],
                shown: 0,
                found: 0,
                beyond_four_sigma: 0,
                nees: 0.0,
            });
            cell.shown += 1;
            if let Some(found) = sightings.iter().find(|s| s.view == Some(n)) {
                let distance2 = distance2(view, found);
                cell.found += 1;
                cell.beyond_four_sigma += usize::from(distance2 > FOUR_SIGMA);
                cell.nees += (0.5 * distance2 - cell.nees) / cell.found as f64;
            }
        }
    }
    cells.into_values().collect()
}
