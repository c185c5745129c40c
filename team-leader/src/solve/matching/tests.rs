use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Value, json};

use crate::solve::input::Problem;
use crate::solve::output::Solution;
use crate::solve::solve_and_explain;

/// Robots at known poses in a room of 4 × 4 m with as many people in it; bearings by plain trigonometry.
struct Room {
    robots: &'static [[f64; 3]],
    people: usize,
    sigma_deg: f64,
    elevations: bool,
}

const THREE: [[f64; 3]; 3] = [[-0.5, -0.5, 20.0], [4.5, 0.0, 130.0], [2.0, 4.8, -80.0]];
const FOUR: [[f64; 3]; 4] = [[-0.5, -0.5, 20.0], [4.5, 0.0, 130.0], [2.0, 4.8, -80.0], [-0.7, 3.5, 0.0]];

impl Room {
    fn draw(&self, seed: u64) -> (Vec<[f64; 3]>, Value) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let people: Vec<[f64; 3]> = (0..self.people)
            .map(|_| [rng.random_range(0.0..4.0), rng.random_range(0.0..4.0), rng.random_range(0.8..1.2)])
            .collect();
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut bearings = Vec::new();
        for (r, [x, y, heading]) in self.robots.iter().enumerate() {
            for (px, py, pz) in people.iter().map(|[x, y, z]| (x, y, z)) {
                let bearing = (py - y).atan2(px - x).to_degrees() - heading + self.sigma_deg * normal();
                let elevation = (pz - 0.6).atan2((px - x).hypot(py - y)).to_degrees() + self.sigma_deg * normal();
                let mut said =
                    json!({"observer": format!("r{r}"), "bearing_deg": bearing, "bearing_sigma_deg": self.sigma_deg});
                if self.elevations {
                    said["elevation_deg"] = json!(elevation);
                    said["elevation_sigma_deg"] = json!(self.sigma_deg);
                }
                bearings.push(said);
            }
        }
        let robots: Vec<Value> = (self.robots.iter().enumerate())
            .map(|(r, [x, y, h])| json!({"id": format!("r{r}"), "pose": {"x_m": x, "y_m": y, "heading_deg": h}}))
            .collect();
        (people, json!({"robots": robots, "bearings": bearings}))
    }
}

fn explained(problem: &Value) -> Solution {
    solve_and_explain(Problem::parse(&problem.to_string()).unwrap())
}

/// Over many rooms: pairings that were wrong and how many were said to be, and the mean squares of errors, made and said.
#[derive(Debug, Default)]
struct Tally {
    targets: f64,
    wrong: f64,
    said: f64,
    /// Variance of the number of wrong ones, if they are as said.
    spread: f64,
    square: f64,
    said_square: f64,
}

impl Room {
    fn tally(&self, draws: u64) -> Tally {
        let mut tally = Tally::default();
        for seed in 0..draws {
            let (people, problem) = self.draw(seed);
            let solution = explained(&problem);
            for target in &solution.targets {
                let Some(part) = solution.explained.iter().find(|e| e.target == target.id) else { continue };
                // Whose bearings they are: the file has them robot by robot in the order of the people.
                let owners: Vec<usize> = target.paired.iter().map(|b| b % people.len()).collect();
                let owner = *owners.iter().max_by_key(|o| owners.iter().filter(|p| p == o).count()).unwrap();
                let said = part.parts.iter().find_map(|p| p.probability).unwrap_or(0.0);
                tally.targets += 1.0;
                tally.wrong += f64::from(u8::from(owners.iter().any(|o| *o != owner)));
                tally.said += said;
                tally.spread += said * (1.0 - said);
                tally.square += (target.x_m - people[owner][0]).powi(2) + (target.y_m - people[owner][1]).powi(2);
                tally.said_square += part.rms_m * part.rms_m;
            }
        }
        tally
    }
}

fn assert_as_said(tally: &Tally) {
    assert!(tally.targets > 500.0 && tally.said > 8.0, "{tally:?}");
    // Wrong ones come two at a time.
    assert!((tally.wrong - tally.said).abs() < 3.0 * (2.0 * tally.spread).sqrt(), "{tally:?}");
    assert!((tally.square / tally.said_square - 1.0).abs() < 0.25, "{tally:?}");
}

#[test]
fn as_many_pairings_of_three_robots_are_wrong_as_are_said_to_be() {
    assert_as_said(&Room { robots: &THREE, people: 3, sigma_deg: 1.0, elevations: false }.tally(3000));
}

#[test]
fn as_many_pairings_with_elevations_or_of_four_robots_are_wrong_as_are_said_to_be() {
    assert_as_said(&Room { robots: &THREE[..2], people: 3, sigma_deg: 1.0, elevations: true }.tally(3000));
    assert_as_said(&Room { robots: &FOUR, people: 4, sigma_deg: 1.5, elevations: false }.tally(2000));
}

#[test]
fn bearings_that_the_file_names_are_taken_at_their_word() {
    let (_, mut problem) = Room { robots: &THREE, people: 2, sigma_deg: 1.0, elevations: false }.draw(1);
    for (n, bearing) in problem["bearings"].as_array_mut().unwrap().iter_mut().enumerate() {
        bearing["target"] = json!(format!("p{}", n % 2));
    }
    let solution = explained(&problem);
    assert_eq!(solution.explained.len(), 2);
    assert!(solution.explained.iter().all(|e| e.parts.iter().all(|p| p.probability.is_none())));
}
