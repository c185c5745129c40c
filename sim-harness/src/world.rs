//! The world that is simulated: a furnished room, robots, people, lamps; where everything is at any instant.
//!
//! A scenario and a seed give a `World`; [`World::at`] is a function of continuous time and nothing else. The room's frame
//! has its origin in the middle of the floor, x along the first size of the room, z up; it is the frame of all truth.
//! Nothing here knows how an agent measures: robots are painted solids, people are capsules with clothes.

pub mod body;
pub mod floor;
pub mod furnishing;
pub mod person;
mod placement;
pub mod robot;
pub mod solid;
pub mod texture;
pub mod vector;
pub mod walk;
pub mod wardrobe;

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;

use crate::scenario::{CameraSpec, FurnitureSpec, LampSpec, Scenario};
use floor::{Floor, Grid};
use furnishing::{Hanging, PaintedBlock};
pub use person::Gait;
pub use robot::{Capture, Robot, RobotState};
use solid::Capsule;
use wardrobe::Clothes;

/// Most lamps of a room.
pub const MAX_LAMPS: usize = 4;
/// Half width of a walking body, for ways round furniture and robots.
const WALKER_MARGIN_M: f64 = 0.32;
/// Walkers keep this far from a robot's axis, besides their own half width.
const ROBOT_KEEP_OUT_M: f64 = 0.42;
/// Layouts of robots and walks that are tried before giving up.
const ATTEMPTS: usize = 200;

/// Why a scenario has no world.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Placing the robots failed.
    #[error(
        "no place in the room for {count} robots at least {apart_m} m apart and at most {within_m} m, in sight of each \
         other with their drives; give them more room or less furniture"
    )]
    NoRoomForRobots {
        /// How many.
        count: usize,
        /// `robots.apart_m`
        apart_m: f64,
        /// `robots.within_m`
        within_m: f64,
    },
    /// Placing the people failed.
    #[error("no free floor for {count} people among furniture and robots; give them more room")]
    NoRoomForPeople {
        /// How many.
        count: usize,
    },
}

/// Everything that is, for the whole run.
#[derive(Debug, Clone)]
pub struct World {
    duration_s: f64,
    seed: u64,
    size_m: [f64; 3],
    ambient: f64,
    ambient_light: Vec<[f64; 2]>,
    camera: CameraSpec,
    lamps: Vec<LampSpec>,
    furniture: Vec<FurnitureSpec>,
    blocks: Vec<PaintedBlock>,
    hangings: Vec<Hanging>,
    robots: Vec<Robot>,
    heights_m: Vec<f64>,
    clothes: Vec<Clothes>,
    camouflaged: usize,
    walks: walk::Walks,
}

/// Everything that moves, at one instant of true time.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Seconds since the start.
    pub time_s: f64,
    /// In the order of [`World::robots`].
    pub robots: Vec<RobotState>,
    /// p1, p2, …
    pub people: Vec<PersonState>,
}

/// A person at an instant.
#[derive(Debug, Clone, PartialEq)]
pub struct PersonState {
    /// p1, p2, …
    pub id: String,
    /// Centroid of the body's volume.
    pub x_m: f64,
    /// Centroid of the body's volume.
    pub y_m: f64,
    /// Centroid of the body's volume, above the floor.
    pub z_m: f64,
    /// Standing.
    pub height_m: f64,
    /// Where the trunk faces.
    pub heading_rad: f64,
    /// Along the floor.
    pub speed_mps: f64,
    /// From which the body follows.
    pub gait: Gait,
}

impl World {
    /// The world of a scenario with a seed.
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, WorldError> {
        let size_m = scenario.room.size_m;
        let blocks = furnishing::blocks(&scenario.room.furniture);
        let floor = Floor::new([size_m[0], size_m[1]], &blocks);
        let mut rng = ChaCha12Rng::seed_from_u64(seed);
        let people = &scenario.people;
        let heights_m: Vec<f64> = (0..people.count)
            .map(|_| people.height_m[0] + (people.height_m[1] - people.height_m[0]) * rng.random::<f64>())
            .collect();
        let clothes = (0..people.count).map(|_| Clothes::random(&mut rng)).collect();
        let half_field = |id: &protocol::id::RobotId| scenario.camera.other(id).and_then(|eye| eye.half_field_rad());
        let wanted: Vec<_> = scenario.robot_ids().into_iter().map(|id| (id, half_field(&id))).collect();
        for _ in 0..ATTEMPTS {
            let mut robots = placement::place(&scenario.robots, &wanted, &floor, &mut rng)?;
            let grid = Grid::new(&floor, &keep_out(&robots), WALKER_MARGIN_M);
            let walks = walk::walk(people, &heights_m, &robots, &grid, scenario.duration_s, &mut rng);
            let Some(walks) = walks else { continue };
            // An exam of this length promises that everybody stops and that somebody crosses every seam.
            let is_exam = people.standing.is_empty()
                && people.ways.is_empty()
                && people.count > 0
                && scenario.duration_s >= 3.0 * people.stop_s + 20.0;
            let keeps_promises = || {
                (0..people.count).all(|n| walks.stops_for(n, people.stop_s - 1.0, scenario.duration_s))
                    && all_seams_crossed(&robots, &walks, people.count, scenario.duration_s)
            };
            if is_exam && !keeps_promises() {
                continue;
            }
            for robot in &mut robots {
                (robot.clock_offset_s, robot.captures) =
                    robot::schedule(&scenario.capture_of(&robot.id), scenario.duration_s, &mut rng);
            }
            return Ok(Self {
                duration_s: scenario.duration_s,
                seed,
                size_m,
                ambient: scenario.room.ambient,
                ambient_light: scenario.room.ambient_light.clone(),
                camera: scenario.camera.clone(),
                lamps: scenario.room.lamps.clone(),
                furniture: scenario.room.furniture.clone(),
                hangings: furnishing::hangings(&scenario.room.furniture, size_m),
                blocks,
                robots,
                heights_m,
                clothes,
                camouflaged: people.camouflaged,
                walks,
            });
        }
        Err(WorldError::NoRoomForPeople { count: people.count })
    }

    /// Everything that moves at a true time; beyond the run people stand still.
    pub fn at(&self, time_s: f64) -> State {
        let people = (0..self.heights_m.len())
            .map(|n| {
                let gait = self.walks.at(n, time_s);
                let c = person::centroid(&person::capsules(&gait, self.heights_m[n]));
                PersonState {
                    id: format!("p{}", n + 1),
                    x_m: f64::from(c.x),
                    y_m: f64::from(c.y),
                    z_m: f64::from(c.z),
                    height_m: self.heights_m[n],
                    heading_rad: gait.heading_rad,
                    speed_mps: self.walks.speed(n, time_s),
                    gait,
                }
            })
            .collect();
        State { time_s, robots: self.robots.iter().map(|r| r.at(time_s)).collect(), people }
    }

    /// Length of the run.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The seed it was made with.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The robots, with their clocks and capture times.
    pub fn robots(&self) -> &[Robot] {
        &self.robots
    }

    /// Along x, along y, height.
    pub fn room_size_m(&self) -> [f64; 3] {
        self.size_m
    }

    /// Furniture and hangings, as the scenario lists them.
    pub fn furniture(&self) -> &[FurnitureSpec] {
        &self.furniture
    }

    /// Furniture as solids.
    pub fn blocks(&self) -> &[PaintedBlock] {
        &self.blocks
    }

    /// What is upright, from above: the room and every solid piece, corners in the room frame counter-clockwise, and between
    /// which heights it is.
    pub fn outlines(&self) -> Vec<([[f64; 2]; 4], [f64; 2])> {
        let rectangle = |[x, y]: [f64; 2], half: [f64; 2], [cos, sin]: [f64; 2]| {
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[a, b]| {
                let [a, b] = [a * half[0], b * half[1]];
                [x + cos * a - sin * b, y + sin * a + cos * b]
            })
        };
        let [length, width, height] = self.size_m;
        let room = (rectangle([0.0; 2], [length / 2.0, width / 2.0], [1.0, 0.0]), [0.0, height]);
        let pieces = self.blocks.iter().map(|block| {
            let (c, h) = (block.block.centre, block.block.half);
            let [x, y, z, half_x, half_y, half_z] = [c.x, c.y, c.z, h.x, h.y, h.z].map(f64::from);
            (rectangle([x, y], [half_x, half_y], block.block.turn.map(f64::from)), [z - half_z, z + half_z])
        });
        std::iter::once(room).chain(pieces).collect()
    }

    /// What hangs on the walls.
    pub fn hangings(&self) -> &[Hanging] {
        &self.hangings
    }

    /// Lamps under the ceiling.
    pub fn lamps(&self) -> &[LampSpec] {
        &self.lamps
    }

    /// Ambient light as a share of the lamps'.
    pub fn ambient(&self) -> f64 {
        self.ambient
    }

    /// The same over time, as [time s, share].
    pub fn ambient_light(&self) -> &[[f64; 2]] {
        &self.ambient_light
    }

    /// The robots' camera.
    pub fn camera(&self) -> &CameraSpec {
        &self.camera
    }

    /// Number of people.
    pub fn people_count(&self) -> usize {
        self.heights_m.len()
    }

    /// What somebody wears.
    pub fn clothes(&self, person: usize) -> &Clothes {
        &self.clothes[person]
    }

    /// Whether somebody's clothes are to be chosen from what is behind.
    pub fn is_camouflaged(&self, person: usize) -> bool {
        person + self.camouflaged >= self.heights_m.len()
    }

    /// The body of a person.
    pub fn capsules(&self, person: &PersonState) -> [Capsule; person::PARTS] {
        person::capsules(&person.gait, person.height_m)
    }
}

/// Discs that walkers keep out of: robots wherever they stand or drive.
fn keep_out(robots: &[Robot]) -> Vec<(Vector2<f64>, f64)> {
    let mut discs = Vec::new();
    for robot in robots {
        let stations = robot.stations();
        discs.push((stations[0], ROBOT_KEEP_OUT_M));
        for way in stations.windows(2) {
            discs.extend((0..=10).map(|i| (way[0] + (way[1] - way[0]) * (f64::from(i) / 10.0), ROBOT_KEEP_OUT_M)));
        }
    }
    discs
}

/// Whether somebody walks through the bearing ±180° of every robot while it stands.
fn all_seams_crossed(robots: &[Robot], walks: &walk::Walks, people: usize, duration_s: f64) -> bool {
    robots.iter().all(|robot| {
        (0..people).any(|n| {
            let behind = |t: f64| {
                let (r, g) = (robot.at(t), walks.at(n, t));
                let (dx, dy) = (g.x_m - r.x_m, g.y_m - r.y_m);
                let (sin, cos) = r.heading_rad.sin_cos();
                (cos * dx + sin * dy < 0.0 && !r.moving).then_some(cos * dy - sin * dx)
            };
            (0..(duration_s * 4.0) as usize).any(|i| {
                let t = i as f64 * 0.25;
                matches!((behind(t), behind(t + 0.25)), (Some(a), Some(b)) if a * b < 0.0)
            })
        })
    })
}

#[cfg(test)]
mod tests;
