use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::golden::golden;
use crate::solve::layout::Nuisance;
use crate::solve::terms::Kind;

/// A target without height and motion.
const PLACE: [bool; TARGET] = [true, true, false, false, false];

#[test]
fn joint_solution_matches_the_golden_numbers() {
    let group = golden("team_ml");
    let (n, m) = (3, 4);
    let mut terms = Vec::new();
    for row in group["inputs"]["meas"].as_array().unwrap() {
        let v = |k: usize| row[k].as_f64().unwrap();
        let (observer, k) = (v(1) as usize, v(2) as usize);
        let (other, kind) = match row[0].as_str().unwrap() {
            "b" => (Other::Robot(k), Kind::Bearing),
            "t" => (Other::Target(k), Kind::Bearing),
            _ => (Other::Robot(k), Kind::Width { radius_m: v(5) }),
        };
        terms.push(Term { observer, other, kind, measured: v(3), sigma: v(4), since_s: 0.0 });
    }
    let truth: Vec<f64> = group["outputs"]["truth"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    let layout = Layout::new(&[true, false, false], &[Nuisance::default(); 3], &[PLACE; 4]);
    let start = State {
        poses: (0..n).map(|r| [truth[3 * r], truth[3 * r + 1], truth[3 * r + 2], 0.0, 0.0]).collect(),
        points: (0..m).map(|t| [truth[3 * n + 2 * t], truth[3 * n + 2 * t + 1], 0.0, 0.0, 0.0]).collect(),
    };
    let joint = solve(&terms, &layout, start);
    assert!(joint.converged && joint.weakest.undetermined.is_empty());
    let golden_x: Vec<f64> = group["outputs"]["x"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    let x: Vec<f64> = joint.state.poses[1..]
        .iter()
        .flat_map(|p| p[..3].to_vec())
        .chain(joint.state.points.iter().flat_map(|p| p[..2].to_vec()))
        .collect();
    for k in 0..x.len() {
        assert!(
            (x[k] - golden_x[k + 3]).abs() < 1e-8 * golden_x[k + 3].abs().max(1.0),
            "{k}: {} {}",
            x[k],
            golden_x[k + 3]
        );
    }
    assert!((joint.chi2 / group["outputs"]["chi2"].as_f64().unwrap() - 1.0).abs() < 1e-8);
    for (k, std) in group["outputs"]["std"].as_array().unwrap().iter().enumerate() {
        let variance = match k.checked_sub(6) {
            None => joint.robot_covariance[(k, k)],
            Some(k) => joint.target_covariances[k / 2][(k % 2, k % 2)],
        };
        assert!((variance.sqrt() / std.as_f64().unwrap() - 1.0).abs() < 1e-7);
    }
}

/// The layouts of the golden cases: pairs that see each other (or one way), targets seen by whom, one width.
#[test]
fn observability_matches_the_golden_numbers() {
    let mutual = |pairs: &[(usize, usize)]| -> Vec<(usize, usize)> {
        pairs.iter().flat_map(|&(a, b)| [(a, b), (b, a)]).collect()
    };
    type Case = (usize, Vec<(usize, usize)>, Vec<Vec<usize>>, bool);
    let cases: Vec<Case> = vec![
        (2, mutual(&[(0, 1)]), vec![], false),
        (2, mutual(&[(0, 1)]), vec![vec![0, 1]; 3], false),
        (2, mutual(&[(0, 1)]), vec![vec![0, 1]; 3], true),
        (2, vec![(0, 1)], vec![vec![0, 1]; 3], false),
        (2, vec![(0, 1)], vec![vec![0, 1]; 20], false),
        (2, vec![], vec![vec![0, 1]; 20], false),
        (3, mutual(&[(0, 1), (1, 2), (0, 2)]), vec![], false),
        (3, mutual(&[(0, 1), (1, 2)]), vec![], false),
        (3, mutual(&[(0, 1), (1, 2)]), vec![vec![0, 1, 2]], false),
        (3, mutual(&[(0, 1), (1, 2)]), vec![vec![0, 1]], false),
        (3, vec![(0, 1), (1, 2), (2, 0)], vec![], false),
        (3, vec![(0, 1), (1, 2), (2, 0)], vec![vec![0, 1, 2]; 2], false),
        (3, vec![], vec![vec![0, 1, 2]; 4], false),
        (3, vec![], vec![vec![0, 1, 2]; 5], false),
        (4, vec![], vec![vec![0, 1, 2, 3]; 3], false),
        (4, vec![], vec![vec![0, 1, 2, 3]; 4], false),
        (4, mutual(&[(0, 1), (1, 2), (2, 3), (3, 0)]), vec![], false),
        (4, mutual(&[(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)]), vec![], false),
    ];
    let golden = golden("observability");
    let outputs = golden["outputs"].as_array().unwrap();
    assert_eq!(outputs.len(), cases.len());
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for ((robots, sightings, targets, width), expected) in cases.iter().zip(outputs) {
        let mut draw = || rng.random_range(-4.0..4.0);
        let state = State {
            poses: (0..*robots).map(|_| [draw(), draw(), draw(), 0.0, 0.0]).collect(),
            points: targets.iter().map(|_| [draw(), draw(), 0.0, 0.0, 0.0]).collect(),
        };
        let term = |observer, other, kind| Term { observer, other, kind, measured: 0.0, sigma: 1.0, since_s: 0.0 };
        let mut terms: Vec<Term> = sightings.iter().map(|&(i, j)| term(i, Other::Robot(j), Kind::Bearing)).collect();
        for (t, seen) in targets.iter().enumerate() {
            terms.extend(seen.iter().map(|&i| term(i, Other::Target(t), Kind::Bearing)));
        }
        if *width {
            terms.push(term(0, Other::Robot(1), Kind::Width { radius_m: 0.2 }));
        }
        let n = targets.len();
        let layout = Layout::new(&vec![false; *robots], &vec![Nuisance::default(); *robots], &vec![PLACE; n]);
        let case = expected["case"].as_str().unwrap();
        assert_eq!(layout.unknowns as u64, expected["unknowns"].as_u64().unwrap(), "{case}");
        assert_eq!(terms.len() as u64, expected["measurements"].as_u64().unwrap(), "{case}");
        let normal = normal(&terms, &layout, &state);
        let found = observability::weakest(&normal, &layout, &[]).undetermined.len();
        assert_eq!(found as u64, expected["nullity"].as_u64().unwrap(), "{case}");
    }
}
