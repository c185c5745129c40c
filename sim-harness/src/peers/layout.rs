//! Layouts by a seed: room, lamps, furniture, posters, people, and robots at 0.6 to 6 m from the first one, all drawn anew.
//!
//! Nothing is arranged to be convenient: furniture and people may hide robots, robots stand in line with each other, and
//! striped boxes stand about that look like robots. Only the observer's own place is kept free.

use std::f64::consts::PI;

use protocol::id::RobotId;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;

use crate::scenario::{
    CameraSpec, CaptureSpec, FurnitureKind, FurnitureSpec, LampSpec, PeopleSpec, RobotsSpec, RoomSpec, Scenario,
    WearOf, WearSpec,
};
use crate::world::World;
use crate::world::floor::Floor;
use crate::world::furnishing;

/// Nearest and farthest peer.
pub const RANGE_M: [f64; 2] = [0.6, 6.0];
/// Of a robot's axis from walls and furniture.
const ROBOT_MARGIN_M: f64 = 0.27;
/// Between the axes of two robots.
const APART_M: f64 = 0.5;
/// Of the observer's axis from furniture.
const OBSERVER_MARGIN_M: f64 = 0.45;
/// Between two pieces of furniture.
const GAP_M: f64 = 0.05;
const FURNITURE: [FurnitureKind; 12] = [
    FurnitureKind::Table,
    FurnitureKind::Table,
    FurnitureKind::Chair,
    FurnitureKind::Chair,
    FurnitureKind::Chair,
    FurnitureKind::Box,
    FurnitureKind::Desk,
    FurnitureKind::Cabinet,
    FurnitureKind::Bookcase,
    FurnitureKind::Sofa,
    FurnitureKind::Box,
    FurnitureKind::StripedBox,
];
const HANGINGS: [FurnitureKind; 3] = [FurnitureKind::Door, FurnitureKind::Poster, FurnitureKind::Whiteboard];
/// Coded bars of four robots, 24 modules of 15°: any eight modules in a row are found in one place of one robot only.
const CODES: [[(f64, u8); 6]; 4] = [
    [(60.0, 2), (120.0, 2), (157.5, 1), (187.5, 1), (247.5, 3), (345.0, 4)],
    [(22.5, 3), (105.0, 4), (157.5, 1), (225.0, 2), (292.5, 1), (337.5, 1)],
    [(7.5, 1), (52.5, 1), (127.5, 3), (187.5, 1), (225.0, 2), (322.5, 3)],
    [(75.0, 2), (127.5, 3), (217.5, 1), (270.0, 2), (315.0, 2), (352.5, 1)],
];
/// Tries of a seed before the next one is taken.
const TRIES: usize = 200;

/// The scenario and world of a seed. The first robot is the observer; without a `team` it is alone.
pub fn draw(camera: &CameraSpec, seed: u64, duration_s: f64, team: Option<Team>) -> Option<(Scenario, World)> {
    (0..TRIES as u64).find_map(|n| {
        let mut rng = ChaCha12Rng::seed_from_u64(seed.wrapping_mul(0x1_0000).wrapping_add(n));
        let scenario = scenario(camera, duration_s, team, &mut rng)?;
        World::new(&scenario, seed).ok().map(|world| (scenario, world))
    })
}

fn scenario(camera: &CameraSpec, duration_s: f64, team: Option<Team>, rng: &mut ChaCha12Rng) -> Option<Scenario> {
    let size_m = [rng.random_range(5.0..11.0), rng.random_range(4.0..9.0), rng.random_range(2.4..3.2)];
    let half = [0.5 * size_m[0], 0.5 * size_m[1]];
    let inside =
        |rng: &mut ChaCha12Rng, margin: f64| [0, 1].map(|k| rng.random_range(-half[k] + margin..half[k] - margin));
    let observer = inside(rng, 0.7);
    let lamps = (0..rng.random_range(2..5))
        .map(|_| LampSpec {
            position_m: inside(rng, 0.4),
            power: rng.random_range(0.5..1.6),
            flicker: if rng.random_bool(0.3) { 0.02 } else { 0.0 },
            light: Vec::new(),
        })
        .collect();
    let mut furniture = furniture(rng, half, observer);
    for _ in 0..rng.random_range(2..7) {
        furniture.push(hanging(rng, half));
    }
    let floor = Floor::new([size_m[0], size_m[1]], &furnishing::blocks(&furniture));
    let place = |x: f64, y: f64| nalgebra::Vector2::new(x, y);

    let wears = team.map_or_else(Vec::new, |team| team.wears(rng));
    let mut poses = vec![[observer[0], observer[1], rng.random_range(-180.0..180.0)]];
    let mut wear = Vec::new();
    for marker in wears {
        let found = (0..60).find_map(|_| {
            let near = rng.random_bool(0.3);
            let range = rng.random_range(RANGE_M[0]..if near { 1.5 } else { RANGE_M[1] });
            let bearing = rng.random_range(-PI..PI);
            let (x, y) = (observer[0] + range * bearing.cos(), observer[1] + range * bearing.sin());
            let free = floor.clearance(place(x, y)) >= ROBOT_MARGIN_M
                && poses.iter().all(|p| (p[0] - x).hypot(p[1] - y) >= APART_M);
            free.then_some([x, y, rng.random_range(-180.0..180.0)])
        });
        let Some(pose) = found else { continue };
        poses.push(pose);
        wear.push(WearOf { robot: RobotId::new(&format!("r{}", poses.len())).ok()?, marker, beacon: None });
    }
    let (people, standing) = people(rng, &poses, |p| floor.clearance(place(p[0], p[1])) >= 0.3);
    Some(Scenario {
        name: "peers".to_owned(),
        duration_s,
        seed: 0,
        room: RoomSpec { size_m, lamps, ambient: rng.random_range(0.25..0.7), ambient_light: Vec::new(), furniture },
        robots: RobotsSpec { count: poses.len(), poses, wear, ..RobotsSpec::default() },
        people: PeopleSpec { count: people, standing, camouflaged: 0, stop_s: 0.0, ..PeopleSpec::default() },
        capture: CaptureSpec::default(),
        camera: camera.clone(),
    })
}

/// What robots wear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Team {
    /// One robot of each kind, sometimes a second one with rings.
    Mixed,
    /// Three robots with rings and one with a plate: nobody has bars.
    Plain,
}

impl Team {
    /// Of one layout.
    fn wears(self, rng: &mut impl Rng) -> Vec<WearSpec> {
        let mut wears = match self {
            Self::Plain => vec![WearSpec::Rings, WearSpec::Rings, WearSpec::Rings, plate()],
            Self::Mixed => {
                let code = CODES[rng.random_range(0..CODES.len())];
                let mut wears = vec![WearSpec::Rings, equal_bars(), coded(&code), plate()];
                if rng.random_bool(0.5) {
                    wears.push(WearSpec::Rings);
                }
                wears
            }
        };
        // Each kind is the first to be placed as often as the others.
        let turn = rng.random_range(0..wears.len());
        wears.rotate_left(turn);
        wears
    }

    /// What any robot of any layout may wear: the fellows that a detector knows of.
    pub fn worn(self) -> Vec<WearSpec> {
        match self {
            Self::Plain => vec![WearSpec::Rings, plate()],
            Self::Mixed => {
                let coded = CODES.iter().map(|code| coded(code));
                [WearSpec::Rings, equal_bars(), plate()].into_iter().chain(coded).collect()
            }
        }
    }
}

fn coded(code: &[(f64, u8)]) -> WearSpec {
    let (azimuths_deg, code): (Vec<f64>, Vec<u8>) = code.iter().copied().unzip();
    WearSpec::Bars { azimuths_deg, bar_width_deg: 15.0, code: Some(code) }
}

fn equal_bars() -> WearSpec {
    WearSpec::Bars { azimuths_deg: (0..8).map(|n| 45.0 * f64::from(n)).collect(), bar_width_deg: 22.5, code: None }
}

fn plate() -> WearSpec {
    WearSpec::Plate { width_m: 0.4, left_edge_m: 0.2, behind_m: 0.06 }
}

fn furniture(rng: &mut ChaCha12Rng, half: [f64; 2], observer: [f64; 2]) -> Vec<FurnitureSpec> {
    let mut out: Vec<FurnitureSpec> = Vec::new();
    let round = |size: [f64; 3]| 0.5 * size[0].hypot(size[1]);
    for _ in 0..rng.random_range(5..15) {
        let kind = FURNITURE[rng.random_range(0..FURNITURE.len())];
        let usual = kind.usual_size_m();
        let size_m = [0, 1, 2].map(|k| usual[k] * rng.random_range(0.75..1.4));
        let reach = round(size_m);
        let yaw_deg = 90.0 * f64::from(rng.random_range(0..4u8)) + rng.random_range(-15.0..15.0);
        let margin = 0.25 * reach;
        let position_m = [0, 1].map(|k| rng.random_range(-half[k] + margin..half[k] - margin));
        let apart = |p: [f64; 2]| (p[0] - position_m[0]).hypot(p[1] - position_m[1]);
        let clear = apart(observer) > reach + OBSERVER_MARGIN_M
            && out.iter().all(|f| apart(f.position_m) > 0.75 * (reach + f.size_m.map_or(0.0, round)) + GAP_M);
        if clear {
            out.push(FurnitureSpec { kind, position_m, yaw_deg, size_m: Some(size_m) });
        }
    }
    out
}

fn hanging(rng: &mut ChaCha12Rng, half: [f64; 2]) -> FurnitureSpec {
    let kind = HANGINGS[rng.random_range(0..HANGINGS.len())];
    let wall = rng.random_range(0..4usize);
    let side = if wall.is_multiple_of(2) { 1.0 } else { -1.0 };
    let mut position_m = [0, 1].map(|k| rng.random_range(-half[k] + 0.6..half[k] - 0.6));
    position_m[wall / 2] = side * (half[wall / 2] - 0.01);
    FurnitureSpec { kind, position_m, yaw_deg: 0.0, size_m: None }
}

/// How many people there are, and where some of them stand: half of the rooms have one between the observer and a robot.
fn people(rng: &mut ChaCha12Rng, poses: &[[f64; 3]], free: impl Fn([f64; 2]) -> bool) -> (usize, Vec<[f64; 2]>) {
    let walking = rng.random_range(0..3usize);
    let mut standing = Vec::new();
    if poses.len() > 1 && rng.random_bool(0.5) {
        let (o, p) = (poses[0], poses[rng.random_range(1..poses.len())]);
        let range = (p[0] - o[0]).hypot(p[1] - o[1]);
        let along = rng.random_range(0.3..0.8);
        let aside = rng.random_range(-0.35..0.35);
        let (ux, uy) = ((p[0] - o[0]) / range, (p[1] - o[1]) / range);
        let place = [o[0] + along * range * ux - aside * uy, o[1] + along * range * uy + aside * ux];
        let apart = poses.iter().all(|p| (p[0] - place[0]).hypot(p[1] - place[1]) > 0.45);
        if apart && free(place) {
            standing.push(place);
        }
    }
    (walking + standing.len(), standing)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_drawn_anew_by_their_seeds_and_hold_every_kind_of_marker() {
        let camera = CameraSpec::default();
        let drawn: Vec<Scenario> =
            (0..6).filter_map(|seed| draw(&camera, seed, 0.2, Some(Team::Mixed))).map(|(s, _)| s).collect();
        assert_eq!(drawn.len(), 6);
        assert!(drawn.windows(2).all(|pair| pair[0].room != pair[1].room));
        let kinds =
            |f: &dyn Fn(&WearSpec) -> bool| drawn.iter().flat_map(|s| &s.robots.wear).filter(|w| f(&w.marker)).count();
        assert!(kinds(&|w| matches!(w, WearSpec::Rings)) >= 3);
        assert!(kinds(&|w| matches!(w, WearSpec::Bars { code: None, .. })) >= 3);
        assert!(kinds(&|w| matches!(w, WearSpec::Bars { code: Some(_), .. })) >= 3);
        assert!(kinds(&|w| matches!(w, WearSpec::Plate { .. })) >= 3);
        assert_eq!(draw(&camera, 3, 0.2, Some(Team::Mixed)).map(|(s, _)| s).as_ref(), Some(&drawn[3]));
    }
}
