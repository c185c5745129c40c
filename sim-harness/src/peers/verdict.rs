//! What tells a robot from what only looks like one: trees and networks of the detector's verdict, learnt from labelled fits (`boost`, `net`).
//!
//! What the detector fitted is labelled by the truth: a robot where the fit's place is within χ²₂'s 99.99 % of one's that looks like it (a cylinder or a plate), none where
//! there is none near. A plate that is not where it is said to be is as bad as no plate; such a cylinder teaches nothing.

use std::fmt::Write as _;
use std::io::{BufRead, Write as _};
use std::path::Path;

use nalgebra::Vector2;
use robot_agent::peers::net::{SIDE, UNSEEN};
use robot_agent::peers::{Basis, Fit, WORTH_A_LOOK, log_odds, together};
use serde::{Deserialize, Serialize};

use super::PeersError;
use super::boost::{self, Tree};
use super::net::{self, Shown};
use super::trial::{Kind, View, turned};

/// Squared sigmas within which a fit's bearing and range are a robot's (χ²₂ at 99.99 %).
const RIGHT_CHI2: f64 = 18.4;
/// Fewest examples of either label.
const LEAST_EXAMPLES: usize = 50;
/// Rooms are judged by trees that were grown without every so manieth of them.
const FOLDS: u64 = 5;

/// A labelled fit, a line of JSON in a file of fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Example {
    /// Of the layout.
    pub seed: u64,
    /// In the layout.
    pub picture: usize,
    /// What the fit stands on.
    pub basis: Basis,
    /// Whether it is a robot; `None` teaches nothing.
    pub is_robot: Option<bool>,
    /// Whether the detector took it for one.
    pub is_taken: bool,
    /// In the order of [`Basis::names`].
    pub traits: Vec<f64>,
    /// What it looks like, if a network is asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub look: Vec<i16>,
}

/// Labels a picture's fits.
pub fn label(seed: u64, picture: usize, fits: Vec<Fit>, views: &[View]) -> impl Iterator<Item = Example> {
    fits.into_iter().map(move |Fit { peer, traits, is_taken }| {
        let is_plate = matches!(traits.basis, Basis::Stripes | Basis::PlateEnd);
        let alike = views.iter().filter(|v| (v.kind == Kind::Rectangle) == is_plate);
        let near = alike.filter(|v| v.may_be(&peer));
        let is_robot = match near.min_by(|a, b| a.apart_m(&peer).total_cmp(&b.apart_m(&peer))) {
            None => Some(false),
            Some(view) => {
                let error = Vector2::new(turned(peer.bearing_rad - view.bearing_rad), peer.range_m - view.range_m);
                let information = peer.covariance.try_inverse();
                let is_there = information.is_some_and(|i| (error.transpose() * i * error)[0] < RIGHT_CHI2);
                // Of a cylinder's fits the better one is kept, of a plate's the first.
                Some(is_there).filter(|is_there| *is_there || is_plate)
            }
        };
        Example { seed, picture, basis: traits.basis, is_robot, is_taken, traits: traits.values, look: traits.picture }
    })
}

/// Writes a file of fits.
pub fn write<'a>(path: &Path, examples: impl Iterator<Item = &'a Example>) -> Result<(), PeersError> {
    let failed = |why: &dyn std::fmt::Display| PeersError(format!("{}: {why}", path.display()));
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).map_err(|e| failed(&e))?);
    for example in examples {
        serde_json::to_writer(&mut file, example).map_err(|e| failed(&e))?;
        file.write_all(b"\n").map_err(|e| failed(&e))?;
    }
    file.flush().map_err(|e| failed(&e))
}

/// Reads a file of fits.
pub fn read(path: &Path) -> Result<Vec<Example>, PeersError> {
    let failed = |why: &dyn std::fmt::Display| PeersError(format!("{}: {why}", path.display()));
    let file = std::fs::File::open(path).map_err(|e| failed(&e))?;
    let mut examples = Vec::new();
    for (n, line) in std::io::BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| failed(&e))?;
        let example: Example = serde_json::from_str(&line).map_err(|e| {
            failed(&format_args!("line {}: {e}; lines as `sim-harness peers --fits` writes them", n + 1))
        })?;
        let traits = example.basis.names().len();
        if example.traits.len() != traits || example.traits.iter().any(|t| !(*t as f32).is_finite()) {
            let why =
                format!("line {}: `traits` are {:?}; {traits} finite numbers would be right", n + 1, example.traits);
            return Err(failed(&why));
        }
        let odd = example.look.iter().find(|gray| !(UNSEEN..=255).contains(*gray));
        if ![0, SIDE * SIDE].contains(&example.look.len()) || odd.is_some() {
            let has = odd.map_or_else(|| format!("{} cells", example.look.len()), |odd| format!("a cell of {odd}"));
            let right = format!("{} cells of {UNSEEN} to 255, or none, would be right", SIDE * SIDE);
            return Err(failed(&format!("line {}: `look` has {has}; {right}", n + 1)));
        }
        examples.push(example);
    }
    Ok(examples)
}

/// The trees and networks that explain the labels best.
pub struct Learnt {
    /// How well they tell apart what they were not learnt from, beside the detector's verdict, for people.
    pub text: String,
    /// Of each basis.
    pub judges: Vec<(Basis, Judge)>,
}

/// What judges fits of one basis.
pub struct Judge {
    trees: Vec<Tree>,
    /// Weights of the network; none where there are no looks to learn from.
    net: Vec<f32>,
}

impl Judge {
    fn learn(examples: &[(&Example, bool)]) -> Self {
        let rows = examples.iter().map(|(e, is_robot)| (&e.traits[..], *is_robot));
        let trees = boost::grow(&rows.collect::<Vec<_>>());
        let is_asked = |e: &Example| !e.look.is_empty() && log_odds(&trees, &e.traits) > WORTH_A_LOOK;
        let shown = examples.iter().filter(|(e, _)| is_asked(e));
        let shown: Vec<Shown> = shown.map(|(e, is_robot)| Shown::new(&e.look, &e.traits, *is_robot)).collect();
        let net = net::learn(&shown.iter().collect::<Vec<_>>());
        Self { trees, net }
    }

    /// As the detector has it.
    fn log_odds(&self, example: &Example) -> f64 {
        let by_trees = log_odds(&self.trees, &example.traits);
        let by_net = || robot_agent::peers::net::log_odds(&self.net, &example.look, &example.traits);
        together(by_trees, if by_trees > WORTH_A_LOOK { by_net() } else { None })
    }
}

/// Learns from labelled fits.
pub fn learn(examples: &[Example]) -> Result<Learnt, PeersError> {
    let mut text = String::new();
    let mut judges = Vec::new();
    for basis in Basis::ALL {
        let of: Vec<(&Example, bool)> =
            examples.iter().filter(|e| e.basis == basis).filter_map(|e| Some((e, e.is_robot?))).collect();
        let robots = of.iter().filter(|(_, is_robot)| *is_robot).count();
        let others = of.len() - robots;
        if robots.min(others) < LEAST_EXAMPLES {
            return Err(PeersError(format!(
                "of {basis:?} there are {robots} fits of robots and {others} others; at least {LEAST_EXAMPLES} of each would be right"
            )));
        }
        let without = |fold: Option<u64>| {
            let seen: Vec<_> = of.iter().filter(|(e, _)| Some(e.seed % FOLDS) != fold).copied().collect();
            Judge::learn(&seen)
        };
        let judge_unseen = |fold: u64| {
            let judge = without(Some(fold));
            let unseen = of.iter().filter(|(e, _)| e.seed % FOLDS == fold);
            unseen.map(|(e, is_robot)| (judge.log_odds(e), *is_robot)).collect::<Vec<_>>()
        };
        let (judged, judge) = std::thread::scope(|scope| {
            let folds: Vec<_> = (0..FOLDS).map(|fold| scope.spawn(move || judge_unseen(fold))).collect();
            let judge = without(None);
            let judged: Result<Vec<_>, _> = folds.into_iter().map(std::thread::ScopedJoinHandle::join).collect();
            (judged, judge)
        });
        let judged = judged.map_err(|_| PeersError(format!("{basis:?}: learning failed")))?.concat();
        let _ = writeln!(text, "{basis:?}: {robots} fits of robots, {others} others");
        let taken = |robot: bool| of.iter().filter(|(e, is_robot)| *is_robot == robot && e.is_taken).count();
        let _ = writeln!(text, "  taken by the detector: {} robots, {} others", taken(true), taken(false));
        for least in [-1.0, 0.0, 0.5, 1.2, 2.0, 3.0, 4.0] {
            let count = |robot: bool| judged.iter().filter(|(odds, is)| *is == robot && *odds >= least).count();
            let (robots, others) = (count(true), count(false));
            let _ = writeln!(text, "  log-odds of {least:.1} and more, rooms unseen: {robots} robots, {others} others");
        }
        judges.push((basis, judge));
    }
    Ok(Learnt { text, judges })
}

/// Writes trees and networks where the detector reads them: a file of trees a basis, a tree a line, and the weights of its network,
/// four bytes each, the least first.
pub fn write_judges(dir: &Path, learnt: &Learnt) -> Result<(), PeersError> {
    for (basis, judge) in &learnt.judges {
        let name = serde_json::to_value(basis).ok().and_then(|name| Some(name.as_str()?.to_owned()));
        let path = dir.join(name.unwrap_or_default());
        let write = |extension: &str, bytes: &[u8]| {
            let path = path.with_extension(extension);
            std::fs::write(&path, bytes).map_err(|e| PeersError(format!("{}: {e}", path.display())))
        };
        // Without looks to learn from there is none: an old one would not go with these trees.
        write("net", &judge.net.iter().flat_map(|weight| weight.to_le_bytes()).collect::<Vec<_>>())?;
        let mut text = "&[\n".to_owned();
        for tree in &judge.trees {
            let nodes: Vec<String> = tree
                .iter()
                .map(|(of, least, nats, [first, second])| format!("({of}, {least:?}, {nats:.4}, [{first}, {second}])"))
                .collect();
            let _ = writeln!(text, "    &[{}],", nodes.join(", "));
        }
        text.push_str("]\n");
        write("in", text.as_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_fits_and_lines_that_are_none_are_told() {
        let error = learn(&[]).err().unwrap().to_string();
        assert!(error.contains("0 fits of robots"), "{error}");
        let path = std::env::temp_dir().join(format!("fits-{}.jsonl", std::process::id()));
        std::fs::write(&path, "{\"seed\":1}\n").unwrap();
        let error = read(&path).unwrap_err().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(error.contains("line 1") && error.contains("picture"), "{error}");
        let traits = vec!["0.5"; Basis::Rings.names().len()].join(",");
        let line = |look: &str| {
            format!(
                r#"{{"seed":1,"picture":0,"basis":"rings","is_robot":true,"is_taken":true,"traits":[{traits}],"look":[{look}]}}"#
            )
        };
        for (look, wrong) in [("1,2,3", "3 cells"), ("-7", "a cell of -7")] {
            std::fs::write(&path, line(look)).unwrap();
            let error = read(&path).unwrap_err().to_string();
            std::fs::remove_file(&path).unwrap();
            assert!(error.contains("line 1") && error.contains(wrong) && error.contains("576"), "{error}");
        }
    }
}
