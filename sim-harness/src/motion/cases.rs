//! The cases as scenarios: the same story in every seed; place, people, clothes, speeds and times differ.

use std::f64::consts::{PI, TAU};

use protocol::id::RobotId;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;

use crate::scenario::{
    CameraSpec, CaptureSpec, DriveSpec, FurnitureKind, FurnitureSpec, LampSpec, PeopleSpec, RobotsSpec, RoomSpec,
    Scenario,
};

/// What happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Case {
    /// Two people pass each other, one nearer than the other, and go on
    Meet,
    /// Two people come up to each other, stand as one blob, and go back where they came from
    TurnBack,
    /// Two people meet, cross the seam together, and part: one goes on, the other turns back
    Seam,
    /// Somebody comes, stands still for 20 s, and goes
    Stand,
    /// All lamps are switched off and, 8 s later, on
    Light,
    /// The light fades to a third within 30 s
    Dusk,
    /// The robot turns on the spot
    Turn,
    /// Somebody walks from 0.8 to 6 m and comes back
    Approach,
    /// Somebody walks about
    Stroll,
}

/// Room of the cases, metres.
const ROOM_M: [f64; 3] = [13.0, 10.0, 2.8];
/// Nobody walks nearer to a wall, metres.
const WALL_M: f64 = 0.4;
/// Beginning of the fading light, and its end, seconds.
pub const DUSK_S: [f64; 2] = [5.0, 35.0];
/// Angle of the arc on which people come, and the points that give it.
const ARC_RAD: f64 = 1.3;
const ARC_POINTS: u32 = 8;
/// From light off to light on, seconds.
const DARK_S: f64 = 8.0;

impl Case {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Meet,
        Self::TurnBack,
        Self::Seam,
        Self::Stand,
        Self::Light,
        Self::Dusk,
        Self::Turn,
        Self::Approach,
        Self::Stroll,
    ];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Meet => "meet",
            Self::TurnBack => "turn-back",
            Self::Seam => "seam",
            Self::Stand => "stand",
            Self::Light => "light",
            Self::Dusk => "dusk",
            Self::Turn => "turn",
            Self::Approach => "approach",
            Self::Stroll => "stroll",
        }
    }

    /// Whether two people meet in it.
    pub fn is_meeting(self) -> bool {
        matches!(self, Self::Meet | Self::TurnBack | Self::Seam)
    }

    /// The case with a seed.
    pub fn scenario(self, seed: u64) -> Scenario {
        let mut draw = Draw { rng: ChaCha12Rng::seed_from_u64(seed ^ ((self as u64 + 1) << 32)) };
        let robot = match self {
            Self::Approach => Stand { x: draw.between(-5.0, -4.6), y: draw.between(-0.7, 0.7), heading: draw.angle() },
            _ => Stand { x: draw.between(-0.7, 0.7), y: draw.between(-0.7, 0.7), heading: draw.angle() },
        };
        let mut lamps: Vec<LampSpec> = [[-3.4, -2.3], [3.4, -2.3], [-3.4, 2.3], [3.4, 2.3]]
            .map(|position_m| LampSpec { position_m, power: 1.0, flicker: 0.0, light: Vec::new() })
            .into();
        lamps[2].flicker = 0.02;
        let mut ambient_light = Vec::new();
        let mut drives = Vec::new();
        let (duration_s, ways) = match self {
            Self::Meet => meet(&robot, &mut draw),
            Self::TurnBack => turn_back(&robot, &mut draw),
            Self::Seam => seam(&robot, &mut draw),
            Self::Stand => stand(&robot, &mut draw),
            Self::Light => {
                let off = draw.between(8.5, 9.5);
                let dark = draw.between(0.0, 0.25);
                let switched =
                    |low: f64| vec![[off, 1.0], [off + 0.01, low], [off + DARK_S, low], [off + DARK_S + 0.01, 1.0]];
                lamps.iter_mut().for_each(|l| l.light = switched(dark));
                // A part of the light from everywhere is that of the lamps, from the walls.
                ambient_light = switched(draw.between(0.4, 0.8));
                (24.0, vec![stroll(&robot, 24.0, &mut draw)])
            }
            Self::Dusk => {
                let [from, to] = DUSK_S;
                lamps.iter_mut().for_each(|l| l.light = vec![[from, 1.0], [to, 0.3]]);
                ambient_light = vec![[from, 1.0], [to, 0.4]];
                (40.0, vec![stroll(&robot, 40.0, &mut draw)])
            }
            Self::Turn => {
                let start_s = draw.between(8.0, 9.0);
                let turn_deg = draw.between(40.0, 120.0) * draw.sign();
                let end_s = start_s + draw.between(2.0, 4.0);
                drives.extend(RobotId::new("r1").map(|robot| DriveSpec {
                    robot,
                    start_s,
                    end_s,
                    distance_m: 0.0,
                    turn_deg,
                }));
                (22.0, vec![stroll(&robot, 22.0, &mut draw)])
            }
            Self::Approach => approach(&robot, &mut draw),
            Self::Stroll => (24.0, vec![stroll(&robot, 24.0, &mut draw)]),
        };
        Scenario {
            name: self.name().to_owned(),
            duration_s,
            seed,
            room: RoomSpec { size_m: ROOM_M, lamps, ambient_light, furniture: furniture(), ..RoomSpec::default() },
            robots: RobotsSpec {
                count: 1,
                poses: vec![[robot.x, robot.y, robot.heading.to_degrees()]],
                drives,
                ..RobotsSpec::default()
            },
            people: PeopleSpec { count: ways.len(), camouflaged: 0, ways, ..PeopleSpec::default() },
            capture: CaptureSpec::default(),
            camera: CameraSpec::default(),
        }
    }
}

type Way = Vec<[f64; 3]>;

/// Two who pass each other: at one time in one direction, at different distances.
fn meet(robot: &Stand, draw: &mut Draw) -> (f64, Vec<Way>) {
    let (bearing, [near, far]) = (draw.angle(), draw.two_ranges());
    let met_s = draw.between(9.0, 9.5);
    let way = |range: f64, side: f64, speed: f64| {
        // From 3 m on one side to 3 m on the other.
        robot.way(bearing, range, &[-3.0, 3.0].map(|s| (met_s + s / speed, side * s)))
    };
    let side = draw.sign();
    (15.0, vec![way(near, side, draw.speed()), way(far, -side, draw.speed())])
}

/// Two who come up to each other and go back.
fn turn_back(robot: &Stand, draw: &mut Draw) -> (f64, Vec<Way>) {
    let (bearing, [near, far]) = (draw.angle(), draw.two_ranges());
    let (met_s, talk_s) = (draw.between(9.0, 9.5), draw.between(0.5, 2.5));
    let reach = draw.between(-0.1, 0.15);
    let way = |range: f64, side: f64, speed: f64| {
        let walk_s = (3.0 + reach) / speed;
        let back_s = met_s + talk_s;
        let points = [(met_s - walk_s, -3.0), (met_s, reach), (back_s, reach), (back_s + walk_s, -3.0)];
        robot.way(bearing, range, &points.map(|(t, s)| (t, side * s)))
    };
    let side = draw.sign();
    (17.0, vec![way(near, side, draw.speed()), way(far, -side, draw.speed())])
}

/// Two who meet before the seam, cross it together, and part behind it.
fn seam(robot: &Stand, draw: &mut Draw) -> (f64, Vec<Way>) {
    let [near, far] = draw.two_ranges();
    let (met_s, speed, side) = (9.0, draw.between(0.7, 1.0), draw.sign());
    // Along the tangent at the seam, 0 on it; together from −0.7 to 0.7 m.
    let together_s = 1.4 / speed;
    let points = |turns: bool, comes_from: f64| {
        let (first_s, last_s) = ((comes_from + 0.7).abs() / speed, 2.5 / speed);
        let end = if turns { -1.8 } else { 3.2 };
        [(met_s - first_s, comes_from), (met_s, -0.7), (met_s + together_s, 0.7), (met_s + together_s + last_s, end)]
    };
    let follows = points(false, -3.2);
    let turns = points(true, 1.8);
    let nearer_turns = draw.rng.random_bool(0.5);
    let way = |range: f64, points: [(f64, f64); 4]| robot.way(PI, range, &points.map(|(t, s)| (t, side * s)));
    let (a, b) = if nearer_turns { (turns, follows) } else { (follows, turns) };
    (met_s + together_s + 2.5 / speed + 1.5, vec![way(near, a), way(far, b)])
}

/// Somebody who stands for 20 s.
fn stand(robot: &Stand, draw: &mut Draw) -> (f64, Vec<Way>) {
    let (bearing, range, side) = (draw.angle(), draw.between(1.2, 3.8), draw.sign());
    let walk_s = 3.0 / draw.speed();
    let came_s = 6.0 + walk_s;
    let points = [(came_s - walk_s, -3.0), (came_s, 0.0), (came_s + 20.0, 0.0), (came_s + 20.0 + walk_s, 3.0)];
    let way = robot.way(bearing, range, &points.map(|(t, s)| (t, side * s)));
    (came_s + 20.0 + walk_s + 2.0, vec![way])
}

/// Somebody who comes from the side to 0.8 m, walks to 6 m and comes back.
fn approach(robot: &Stand, draw: &mut Draw) -> (f64, Vec<Way>) {
    // Into the long side of the room.
    let away = draw.between(-0.3, 0.3) - robot.heading;
    let drift = draw.between(-0.12, 0.12);
    let speed = draw.between(0.6, 0.9);
    let mut way = robot.way(away + 1.2 * draw.sign(), 2.2, &[(6.0, 0.0)]);
    let mut t = 6.0;
    for (range, turn) in [(0.8, 0.0), (6.0, drift), (1.5, 2.0 * drift), (4.0, drift)] {
        let [_, x, y] = robot.polar(0.0, away + turn, range);
        let [_, from_x, from_y] = way[way.len() - 1];
        t += (x - from_x).hypot(y - from_y) / speed;
        way.push([t, x, y]);
        // A breath at the turning point.
        t += 0.4;
        way.push([t, x, y]);
    }
    (t + 0.5, vec![way])
}

/// Somebody who walks about between 1.2 and 4 m, round the robot and back.
fn stroll(robot: &Stand, duration_s: f64, draw: &mut Draw) -> Way {
    let (mut bearing, speed) = (draw.angle(), draw.between(0.7, 1.2));
    let mut side = draw.sign();
    let mut t = -1.0;
    let mut way = vec![robot.polar(t, bearing, draw.between(1.5, 3.5))];
    while t < duration_s {
        if draw.rng.random_bool(0.3) {
            side = -side;
        }
        bearing += side * draw.between(0.3, 1.0);
        let [_, x, y] = robot.polar(0.0, bearing, draw.between(1.3, 4.0));
        let [_, from_x, from_y] = way[way.len() - 1];
        t += (x - from_x).hypot(y - from_y).max(0.1) / speed;
        way.push([t, x, y]);
    }
    way
}

/// Where the robot is.
struct Stand {
    x: f64,
    y: f64,
    heading: f64,
}

impl Stand {
    /// A place at a bearing and a distance from the robot, within the room.
    fn polar(&self, time_s: f64, bearing: f64, range_m: f64) -> [f64; 3] {
        self.beside(time_s, bearing, range_m, 0.0)
    }

    /// A way along the tangent at a bearing and a distance, as (time, metres to the left of it as the robot sees it); whoever goes it
    /// comes round the robot on an arc before.
    fn way(&self, bearing: f64, range_m: f64, points: &[(f64, f64)]) -> Way {
        let mut way = Way::new();
        if let Some((start_s, aside_m)) = points.first() {
            let first_s = -1.0;
            let (radius_m, angle) = (range_m.hypot(*aside_m), bearing + aside_m.atan2(range_m));
            way.extend((0..ARC_POINTS).map(|n| {
                let share = f64::from(n) / f64::from(ARC_POINTS);
                let ahead = (1.0 - share) * ARC_RAD.copysign(*aside_m);
                self.polar(first_s + share * (start_s - first_s), angle + ahead, radius_m)
            }));
        }
        way.extend(points.iter().map(|(t, aside)| self.beside(*t, bearing, range_m, *aside)));
        way
    }

    /// The same, `aside_m` to the left of it.
    fn beside(&self, time_s: f64, bearing: f64, range_m: f64, aside_m: f64) -> [f64; 3] {
        let (sin, cos) = (self.heading + bearing).sin_cos();
        let inside = |place: f64, size: f64| place.clamp(WALL_M - size / 2.0, size / 2.0 - WALL_M);
        let x = self.x + range_m * cos - aside_m * sin;
        let y = self.y + range_m * sin + aside_m * cos;
        [time_s, inside(x, ROOM_M[0]), inside(y, ROOM_M[1])]
    }
}

struct Draw {
    rng: ChaCha12Rng,
}

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    fn angle(&mut self) -> f64 {
        self.between(0.0, TAU)
    }

    fn sign(&mut self) -> f64 {
        if self.rng.random_bool(0.5) { 1.0 } else { -1.0 }
    }

    fn speed(&mut self) -> f64 {
        self.between(0.75, 1.25)
    }

    /// Of two who pass each other within arm's length.
    fn two_ranges(&mut self) -> [f64; 2] {
        let near = self.between(1.5, 3.2);
        [near, near + self.between(0.5, 0.9)]
    }
}

/// Along the walls.
fn furniture() -> Vec<FurnitureSpec> {
    let piece = |kind, x: f64, y: f64, yaw_deg| FurnitureSpec { kind, position_m: [x, y], yaw_deg, size_m: None };
    use FurnitureKind::{Bookcase, Cabinet, Desk, Door, Poster, Whiteboard};
    vec![
        piece(Bookcase, -2.5, 4.83, 0.0),
        piece(Bookcase, 2.6, 4.83, 0.0),
        piece(Cabinet, -4.0, -4.77, 180.0),
        piece(Cabinet, 3.1, -4.77, 180.0),
        piece(Desk, 6.12, -2.0, -90.0),
        piece(Door, -6.5, 1.2, 0.0),
        piece(Door, 0.4, 5.0, 0.0),
        piece(Poster, -6.5, -2.0, 0.0),
        piece(Poster, 6.5, 1.0, 0.0),
        piece(Poster, 6.5, 3.2, 0.0),
        piece(Poster, -5.0, 5.0, 0.0),
        piece(Poster, 5.0, 5.0, 0.0),
        piece(Whiteboard, 0.0, -5.0, 0.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_is_a_scenario_that_a_person_could_have_written() {
        for case in Case::ALL {
            for seed in 0..20 {
                let scenario = case.scenario(seed);
                let text = toml::to_string(&scenario).unwrap();
                assert_eq!(Scenario::parse(&text, case.name()).unwrap(), scenario);
            }
        }
    }

    #[test]
    fn people_keep_out_of_the_robot() {
        for case in Case::ALL {
            for seed in 0..20 {
                let Scenario { robots, people, .. } = case.scenario(seed);
                let [rx, ry, _] = robots.poses[0];
                for pair in people.ways.iter().flat_map(|way| way.windows(2)) {
                    for i in 0..=10 {
                        let at = |k: usize| pair[0][k] + (pair[1][k] - pair[0][k]) * f64::from(i) / 10.0;
                        assert!((at(1) - rx).hypot(at(2) - ry) > 0.6, "{} {seed}", case.name());
                    }
                }
            }
        }
    }
}
