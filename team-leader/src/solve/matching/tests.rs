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

#[test]
fn three_rays_that_meet_are_not_doubted_and_not_wrong() {
    let (mut targets, mut said) = (0, 0.0);
    for seed in 0..200 {
        let (people, problem) = Room { robots: &THREE, people: 3, sigma_deg: 0.5, elevations: false }.draw(seed);
        let solution = explained(&problem);
        for target in solution.targets.iter().filter(|t| t.paired.len() == 3) {
            // Whose bearings they are: the file has them robot by robot in the order of the people.
            let owners: Vec<usize> = target.paired.iter().map(|b| b % people.len()).collect();
            assert!(owners.iter().all(|o| *o == owners[0]), "seed {seed}: {owners:?}");
            let part = solution.explained.iter().find(|e| e.target == target.id).unwrap();
            said += part.parts.iter().find_map(|p| p.probability).unwrap();
            targets += 1;
        }
    }
    assert!(targets > 80 && said < 1.0, "{targets} {said}");
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
