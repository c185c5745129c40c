//! Numbers of a solution in words.

use super::input::Problem;
use super::joint::Joint;
use super::layout::{Layout, State};
use super::terms::{Kind, Other, Term};

/// A direction that is scale to this cosine is called so.
const SCALE_COSINE: f64 = 0.95;

/// What is known least, and how well it is known.
pub fn weakest(joint: &Joint, layout: &Layout, problem: &Problem) -> String {
    let weakest = &joint.weakest;
    if weakest.direction.is_empty() {
        return "nothing is unknown".to_owned();
    }
    if is_scale(&weakest.direction, joint, layout) {
        let scale = "scale of the layout: all distances together";
        return if weakest.sigma.is_finite() {
            format!("{scale} (sigma {:.4} m)", weakest.sigma)
        } else {
            format!("{scale} (not determined)")
        };
    }
    let (text, size, unit) = largest(&weakest.direction, layout, problem);
    if weakest.sigma.is_finite() {
        format!("{text} (sigma {:.4} {unit})", weakest.sigma * size)
    } else {
        format!("{text} (not determined)")
    }
}

/// Directions that nothing determines.
pub fn undetermined(joint: &Joint, layout: &Layout, problem: &Problem) -> Vec<String> {
    let all = joint.weakest.undetermined.iter();
    all.map(|v| {
        if is_scale(v, joint, layout) {
            "scale of the layout: all distances together".to_owned()
        } else {
            largest(v, layout, problem).0
        }
    })
    .collect()
}

/// The largest part of a direction: what it is, how large, in which unit.
fn largest(v: &[f64], layout: &Layout, problem: &Problem) -> (String, f64, &'static str) {
    let mut parts: Vec<(f64, String, f64, &'static str)> = Vec::new();
    let at = |column: Option<usize>| column.map_or(0.0, |c| v[c]);
    let mut place = |columns: &[Option<usize>; 5], id: &str| {
        let (x, y) = (at(columns[0]), at(columns[1]));
        let along = y.atan2(x).to_degrees().rem_euclid(180.0);
        parts.push((x.hypot(y), format!("position of {id} along {along:.0}°"), x.hypot(y), "m"));
    };
    for (columns, robot) in layout.robots.iter().zip(&problem.robots) {
        place(columns, &robot.id);
    }
    for (columns, id) in layout.targets.iter().zip(&problem.targets) {
        place(columns, id);
    }
    for (columns, robot) in layout.robots.iter().zip(&problem.robots) {
        let [turn, bias, offset] = [2, 3, 4].map(|k| at(columns[k]).abs());
        parts.push((turn, format!("heading of {}", robot.id), turn.to_degrees(), "°"));
        parts.push((bias, format!("bearing bias of {}", robot.id), bias.to_degrees(), "°"));
        parts.push((offset, format!("time offset of {}", robot.id), offset, "s"));
    }
    for (columns, id) in layout.targets.iter().zip(&problem.targets) {
        let [height, vx, vy] = [2, 3, 4].map(|k| at(columns[k]).abs());
        parts.push((height, format!("height of {id}"), height, "m"));
        parts.push((vx.hypot(vy), format!("velocity of {id}"), vx.hypot(vy), "m/s"));
    }
    let best = parts.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| (String::new(), 0.0, ""), |(_, text, size, unit)| (text, size, unit))
}

/// Whether a direction blows the layout up around its fixed part.
fn is_scale(direction: &[f64], joint: &Joint, layout: &Layout) -> bool {
    let held = layout.robots.iter().zip(&joint.state.poses).find(|(c, _)| c[0].is_none()).map(|(_, p)| *p);
    let Some(origin) = held else { return false };
    let (mut dot, mut norm2, mut places) = (0.0, 0.0, 0);
    let poses = layout.robots.iter().zip(&joint.state.poses);
    let points = layout.targets.iter().zip(&joint.state.points);
    for (columns, at) in poses.chain(points) {
        for k in 0..2 {
            if let Some(c) = columns[k] {
                let away = at[k] - origin[k];
                dot += away * direction[c];
                norm2 += away * away;
            }
        }
        places += usize::from(columns[0].is_some());
    }
    places >= 2 && norm2 > 0.0 && (dot / norm2.sqrt()).abs() > SCALE_COSINE
}

/// The measurement that fits worst.
pub fn worst(terms: &[Term], state: &State, problem: &Problem) -> String {
    let residual = |t: &Term| t.row(state).residual;
    let Some(term) = terms.iter().max_by(|a, b| residual(a).abs().total_cmp(&residual(b).abs())) else {
        return "nothing is measured".to_owned();
    };
    format!("measurements contradict each other; {}", measurement(term, residual(term), problem))
}

/// A measurement and by how much it is off.
pub fn measurement(term: &Term, residual: f64, problem: &Problem) -> String {
    let what = match term.kind {
        Kind::Bearing | Kind::Tangent { .. } | Kind::BodyPoint { .. } => "bearing",
        Kind::Range => "range",
        Kind::Width { .. } => "width",
        Kind::Heading => "heading",
        Kind::Way { .. } => "way",
        _ => "elevation",
    };
    let whom = match term.other {
        Other::Robot(r) => &problem.robots[r].id,
        Other::Target(t) => &problem.targets[t],
    };
    let from = &problem.robots[term.observer].id;
    format!("the {what} of {whom} from {from} is off by {:.1} sigmas", residual.abs())
}
