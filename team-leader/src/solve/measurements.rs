//! What a problem measures, number by number.

use protocol::marker::Marker;

use super::input::{Moved, Part, Problem, Sighting};
use super::terms::{Kind, Other, Term};

/// All measurements between things that take part, and which targets do.
pub fn terms_of(problem: &Problem, placed: &[bool]) -> (Vec<Term>, Vec<bool>) {
    let mut terms = Vec::new();
    for s in &problem.sightings {
        let Some(peer) = s.peer.filter(|p| placed[*p] && placed[s.observer]) else { continue };
        sighting_terms(problem, s, peer, &mut terms);
    }
    for (robot, moved) in problem.robots.iter().enumerate() {
        if let Some(moved) = moved.moved.filter(|m| placed[robot] && placed[m.from]) {
            way_terms(&moved, robot, &mut terms);
        }
    }
    let m = problem.targets.len();
    let (mut known, mut flat) = (vec![false; m], vec![false; m]);
    for l in &problem.landmarks {
        (known[l.target], flat[l.target]) = (true, l.z_m.is_none());
    }
    let mut first: Vec<Option<usize>> = vec![None; m];
    let mut located = vec![false; m];
    for b in problem.bearings.iter().filter(|b| placed[b.observer]) {
        let Some(t) = b.target else { continue };
        // A single ray places nothing, unless it is a landmark's.
        located[t] |= known[t] || first[t].is_some_and(|o| o != b.observer);
        first[t] = first[t].or(Some(b.observer));
    }
    for b in &problem.bearings {
        let Some(t) = b.target.filter(|t| located[*t] && placed[b.observer]) else { continue };
        let since_s = b.time_s.zip(problem.times[t]).map_or(0.0, |(time, reference)| time - reference);
        let term = |kind, (measured, sigma)| {
            let (observer, other) = (b.observer, Other::Target(t));
            Term { observer, other, kind, measured, sigma, since_s }
        };
        terms.push(term(Kind::Bearing, b.bearing));
        if let Some(elevation) = b.elevation.filter(|_| !flat[t]) {
            terms.push(term(Kind::Elevation { camera_m: problem.robots[b.observer].camera_height_m }, elevation));
        }
    }
    (terms, located)
}

/// The way of a robot from one place to the next, whitened.
fn way_terms(moved: &Moved, robot: usize, terms: &mut Vec<Term>) {
    // The covariance was checked to be one when the file was read.
    let Some(whitening) = moved.covariance.cholesky().and_then(|c| c.l().try_inverse()) else { return };
    for row in whitening.row_iter() {
        let kind = Kind::Way { step: moved.step, weights: [row[0], row[1], row[2]] };
        let (observer, other) = (moved.from, Other::Robot(robot));
        terms.push(Term { observer, other, kind, measured: 0.0, sigma: 1.0, since_s: 0.0 });
    }
}

/// The features are the measurement where there are any; else bearing and range. A heading is one beside what does not show it.
fn sighting_terms(problem: &Problem, s: &Sighting, peer: usize, terms: &mut Vec<Term>) {
    let camera_m = problem.robots[s.observer].camera_height_m;
    let mut push = |kind, measured, sigma| {
        terms.push(Term { observer: s.observer, other: Other::Robot(peer), kind, measured, sigma, since_s: 0.0 });
    };
    if s.features.is_empty() {
        for (kind, value) in [(Kind::Bearing, s.bearing), (Kind::Range, s.range)] {
            if let Some((measured, sigma)) = value {
                push(kind, measured, sigma);
            }
        }
    }
    // Bars and edges show the heading themselves: one beside them was found by them.
    let shown = s.features.iter().any(|f| matches!(f.part, Part::Bar(_) | Part::Edge(_)));
    if let Some((measured, sigma)) = s.heading.filter(|_| !shown) {
        push(Kind::Heading, measured, sigma);
    }
    for f in &s.features {
        let ends = |make: &dyn Fn(f64) -> Kind, heights: [f64; 2], push: &mut dyn FnMut(Kind, f64, f64)| {
            for (z_m, measured) in heights.into_iter().zip(f.elevation_rad.into_iter().flatten()) {
                push(make(z_m), measured, f.elevation_sigma_rad);
            }
        };
        match (&problem.robots[peer].marker, f.part) {
            (
                Marker::Cylinder { radius_m, height_m, .. } | Marker::Bars { radius_m, height_m, .. },
                Part::Left | Part::Right,
            ) => {
                let radius_m = *radius_m;
                let side = if f.part == Part::Left { 1.0 } else { -1.0 };
                push(Kind::Tangent { radius_m, side }, f.bearing_rad, f.sigma_rad);
                ends(&|z_m| Kind::RingElevation { radius_m, z_m, camera_m }, *height_m, &mut push);
            }
            (Marker::Bars { radius_m, azimuths_deg, height_m, .. }, Part::Bar(n)) => {
                let Some(azimuth) = azimuths_deg.get(n) else { continue };
                let (sin, cos) = azimuth.to_radians().sin_cos();
                let at_m = [radius_m * cos, radius_m * sin];
                push(Kind::BodyPoint { at_m }, f.bearing_rad, f.sigma_rad);
                ends(&|z_m| Kind::BodyPointElevation { at_m, z_m, camera_m }, *height_m, &mut push);
            }
            (marker @ Marker::Rectangle { height_m, bottom_m, .. }, Part::Edge(n)) => {
                let Some(edge) = marker.edge_points().and_then(|edges| edges.get(n).copied()) else { continue };
                let at_m = [edge.x, edge.y];
                push(Kind::BodyPoint { at_m }, f.bearing_rad, f.sigma_rad);
                let heights = [*bottom_m, bottom_m + height_m];
                ends(&|z_m| Kind::BodyPointElevation { at_m, z_m, camera_m }, heights, &mut push);
            }
            // `fitting` has left no others, and said so.
            _ => {}
        }
    }
}
