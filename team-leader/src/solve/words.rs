//! Numbers of a solution in words.

use nalgebra::DVector;

use super::input::Problem;
use super::joint::{Joint, Layout, State};
use super::terms::{Kind, Other, Term};

/// A direction that is scale to this cosine is called so.
const SCALE_COSINE: f64 = 0.95;

/// What is known least, and how well it is known.
pub fn weakest(joint: &Joint, layout: &Layout, problem: &Problem) -> String {
    if joint.weakest.is_empty() {
        return "nothing is unknown".to_owned();
    }
    let known = |text: String, size: f64, unit: &str| {
        if joint.weakest_sigma.is_finite() {
            format!("{text} (sigma {:.4} {unit})", joint.weakest_sigma * size)
        } else {
            format!("{text} (not determined)")
        }
    };
    if is_scale(joint, layout) {
        return if joint.weakest_sigma.is_finite() {
            format!("scale of the layout: all distances together (sigma {:.4} m)", joint.weakest_sigma)
        } else {
            "scale of the layout: all distances together (not determined)".to_owned()
        };
    }
    let v = &joint.weakest;
    let mut parts: Vec<(f64, String, f64, &str)> = Vec::new();
    for (column, robot) in layout.robots.iter().zip(&problem.robots) {
        if let Some(c) = *column {
            let along = v[c + 1].atan2(v[c]).to_degrees().rem_euclid(180.0);
            let size = v[c].hypot(v[c + 1]);
            parts.push((size, format!("position of {} along {along:.0}°", robot.id), size, "m"));
            let turn = v[c + 2].abs();
            parts.push((turn, format!("heading of {}", robot.id), turn.to_degrees(), "°"));
        }
    }
    for ((column, height), id) in layout.targets.iter().zip(&layout.heights).zip(&problem.targets) {
        if let Some(c) = *column {
            let along = v[c + 1].atan2(v[c]).to_degrees().rem_euclid(180.0);
            let size = v[c].hypot(v[c + 1]);
            parts.push((size, format!("position of {id} along {along:.0}°"), size, "m"));
        }
        if let Some(c) = *height {
            parts.push((v[c].abs(), format!("height of {id}"), v[c].abs(), "m"));
        }
    }
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    parts.into_iter().next().map_or_else(String::new, |(_, text, size, unit)| known(text, size, unit))
}

/// Whether the weakest direction blows the layout up around its fixed part.
fn is_scale(joint: &Joint, layout: &Layout) -> bool {
    let mut scale = DVector::zeros(layout.unknowns);
    let held = layout.robots.iter().zip(&joint.state.poses).find(|(c, _)| c.is_none()).map(|(_, p)| *p);
    let Some(origin) = held else { return false };
    for (column, pose) in layout.robots.iter().zip(&joint.state.poses) {
        if let Some(c) = *column {
            (scale[c], scale[c + 1]) = (pose[0] - origin[0], pose[1] - origin[1]);
        }
    }
    for (column, point) in layout.targets.iter().zip(&joint.state.points) {
        if let Some(c) = *column {
            (scale[c], scale[c + 1]) = (point[0] - origin[0], point[1] - origin[1]);
        }
    }
    let unknown_places = layout.robots.iter().chain(&layout.targets).flatten().count();
    unknown_places >= 2 && scale.norm() > 0.0 && (scale.dot(&joint.weakest) / scale.norm()).abs() > SCALE_COSINE
}

/// The measurement that fits worst.
pub fn worst(terms: &[Term], state: &State, problem: &Problem) -> String {
    let standardised = |t: &Term| {
        let other = match t.other {
            Other::Robot(r) => state.poses[r],
            Other::Target(k) => state.points[k],
        };
        (t.predict(state.poses[t.observer], other).residual / t.sigma).abs()
    };
    let Some(term) = terms.iter().max_by(|a, b| standardised(a).total_cmp(&standardised(b))) else {
        return "nothing is measured".to_owned();
    };
    let what = match term.kind {
        Kind::Bearing | Kind::Tangent { .. } | Kind::BodyPoint { .. } => "bearing",
        Kind::Range => "range",
        Kind::Width { .. } => "width",
        Kind::Heading => "heading",
        _ => "elevation",
    };
    let whom = match term.other {
        Other::Robot(r) => &problem.robots[r].id,
        Other::Target(t) => &problem.targets[t],
    };
    format!(
        "measurements contradict each other; the {what} of {whom} from {} is off by {:.1} sigmas",
        problem.robots[term.observer].id,
        standardised(term)
    )
}
