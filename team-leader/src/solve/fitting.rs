//! Features that are of another kind of marker than the peer wears measure nothing of it.

use protocol::marker::Marker;

use super::bars;
use super::input::{Part, Problem};

/// `None` where the marker has this part, else what it has.
pub fn misfit(marker: &Marker, part: Part) -> Option<String> {
    let (fits, has) = match marker {
        Marker::Cylinder { .. } => (matches!(part, Part::Left | Part::Right), "\"left\" or \"right\"".to_owned()),
        Marker::Bars { azimuths_deg, .. } => {
            let fits = match part {
                Part::Left | Part::Right | Part::UnnumberedBar => true,
                Part::Bar(n) => n < azimuths_deg.len(),
                Part::Edge(_) => false,
            };
            let last = azimuths_deg.len().saturating_sub(1);
            (fits, format!("\"left\", \"right\", or \"bar\" with an index up to {last} or null"))
        }
        Marker::Rectangle { .. } => (matches!(part, Part::Edge(0 | 1)), "\"edge\" with index 0 or 1".to_owned()),
    };
    (!fits).then_some(has)
}

/// Makes features ready to be measured by, when it is known who is whom. Gives what was left out, in words.
pub fn prepare(problem: &mut Problem) -> Vec<String> {
    let mut said = std::mem::take(&mut problem.remarks);
    said.extend(keep_fitting(problem));
    said.extend(bars::number_sightings(problem));
    said
}

/// Leaves out features that the peers' markers do not have, and says so. Files that name a peer and give nothing else of it
/// are refused before; here are those with a bearing beside, and those whose peer was found.
fn keep_fitting(problem: &mut Problem) -> Vec<String> {
    let robots = &problem.robots;
    let mut said = Vec::new();
    let mut numbers = 0..;
    problem.sightings.retain_mut(|sighting| {
        let number: usize = numbers.next().unwrap_or_default();
        let Some(peer) = sighting.peer else { return true };
        let marker = &robots[peer].marker;
        let mut odd: Vec<String> = Vec::new();
        sighting.features.retain(|feature| {
            let is_odd = misfit(marker, feature.part).is_some();
            odd.extend(is_odd.then(|| feature.part.in_words()));
            !is_odd
        });
        if odd.is_empty() {
            return true;
        }
        let rest = match (sighting.features.is_empty(), sighting.bearing.is_some()) {
            (false, _) => "the other features are used",
            (true, true) => "its bearing is used instead",
            (true, false) => "nothing is left of it",
        };
        said.push(format!(
            "sightings[{number}]: {} sees {}, who wears a marker of kind {}: {} is not of it and is left out; {rest}",
            robots[sighting.observer].id,
            robots[peer].id,
            marker.kind_name(),
            odd.join(", ")
        ));
        !sighting.features.is_empty() || sighting.bearing.is_some()
    });
    said
}
