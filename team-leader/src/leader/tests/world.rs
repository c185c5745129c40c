//! A flat world of robots and people, made from geometry, noise and a seed.

use std::collections::BTreeMap;

use protocol::id::{RobotId, TrackId};
use protocol::marker::Marker;
use protocol::message::{
    Announcement, CameraSummary, ClockReply, ElevationEnd, Motion, ObjectClass, Observation, PeerSighting,
    SightedRange, Stages, TeamMap, TrackObservation, TrackState,
};
use protocol::quantity::{Angle16, Fraction8, LogSigma, Millimetres};
use protocol::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::leader::{Input, Leader, Output};

const ROOM_M: [f64; 2] = [8.0, 6.0];
const STEP_S: f64 = 0.005;
const HALF_PERSON_M: f64 = 0.23;
/// What a robot states of the bearing of a piece of a body or of what is nobody, metres aside: the median of 1,134 such tracks in ten
/// recorded runs is 0.15, of 382 pieces 0.17.
const NOBODY_SIGMA_M: f64 = 0.15;
const START_S: f64 = 1_700_000_000.0;

#[derive(Debug, Clone)]
pub struct Settings {
    pub robots: usize,
    pub people: usize,
    pub duration_s: f64,
    /// Which robots drive, from when to when.
    pub drives: Vec<(usize, f64, f64)>,
    /// How late a robot says that it drives, seconds.
    pub notices_after_s: f64,
    pub edge_sigma_deg: f64,
    pub pair_bias_deg: f64,
    pub common_bias_deg: f64,
    pub sway_m: f64,
    pub sway_memory_s: f64,
    pub white_deg: f64,
    /// Objects in one region have the region's bearing and width, instead of their own as well as it goes.
    pub regions: bool,
    /// How many things a robot follows that are nobody: shadows, ghosts, flicker.
    pub clutter: usize,
    /// Share of the time in which a near person falls into two tracks.
    pub split: f64,
    /// How often a second a robot loses sight of a person for 1 to 4 s; it comes back under another number.
    pub losses_per_s: f64,
    /// Chance that a robot goes on with exchanged numbers when two people pass each other in its picture.
    pub exchanges: f64,
    /// Share of bearings that are off by half a body.
    pub outliers: f64,
    /// Stated sigmas are wrong by factors of this spread (1/√2 of the standard deviation of the logarithm: 0.41 in ten recorded runs),
    /// the same over a track's life.
    pub sigma_spread: f64,
    /// How long a robot says of who was with others that it may be somebody else (until it has looked at the clothes), seconds.
    pub doubt_s: f64,
    /// Names of the robots in the order of the world.
    pub names: Vec<&'static str>,
    /// Given places instead of random ones.
    pub places: Option<Vec<[f64; 3]>>,
    /// What is wrong.
    pub faults: Vec<Fault>,
    /// Where robots that drive go, instead of a drawn place.
    pub goals: BTreeMap<usize, [f64; 3]>,
    /// A wall across the room at this x, and until when the door in it is shut: nobody sees what is behind.
    pub wall: Option<(f64, f64)>,
    /// From when on the first robot that is told of a better place goes there.
    pub follows_from_s: Option<f64>,
    /// Which robot's program is started anew, and since when it announces what it wears: it is no thicker any more.
    pub corrected: Option<(usize, f64)>,
}

/// What is wrong with a robot, by its number.
#[derive(Debug, Clone, Copy)]
pub enum Fault {
    /// It is so many times as thick as it announces.
    Thick(usize, f64),
    /// Every marker says a name; this one says that of another robot.
    Called(usize, usize),
    /// Its stamps say later than its pictures are, seconds.
    Late(usize, f64),
    /// Errors of its tracks are so many times as large as stated.
    Noisy(usize, f64),
    /// Its tracks' bearings are turned, degrees.
    Turned(usize, f64),
    /// Somebody puts it elsewhere at a time and it does not notice.
    Carried(usize, f64, [f64; 3]),
    /// It sees another robot in the opposite direction.
    Backwards(usize, usize),
    /// It sees no robot.
    Blind(usize),
    /// It says that it drives while it stands, from when to when.
    Claims(usize, f64, f64),
    /// From when on two robots do not see each other.
    Apart(usize, usize, f64),
}

impl Settings {
    /// As recorded observations of rendered pictures are.
    pub fn unkind() -> Self {
        Self {
            clutter: 2,
            split: 0.2,
            losses_per_s: 0.08,
            exchanges: 0.3,
            outliers: 0.05,
            sigma_spread: 0.3,
            doubt_s: 1.0,
            ..Self::default()
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            robots: 3,
            people: 4,
            duration_s: 60.0,
            drives: vec![(2, 20.0, 30.0)],
            notices_after_s: 0.25,
            edge_sigma_deg: 0.05,
            pair_bias_deg: 0.015,
            common_bias_deg: 0.006,
            sway_m: 0.03,
            sway_memory_s: 0.25,
            white_deg: 0.15,
            regions: false,
            clutter: 0,
            split: 0.0,
            losses_per_s: 0.0,
            exchanges: 0.0,
            outliers: 0.0,
            sigma_spread: 0.0,
            doubt_s: 0.0,
            names: vec!["r1", "r2", "r3", "r4", "r5", "r6"],
            places: None,
            faults: Vec::new(),
            goals: BTreeMap::new(),
            wall: None,
            follows_from_s: None,
            corrected: None,
        }
    }
}

#[derive(Debug, Clone)]
pub struct RobotTruth {
    pub id: RobotId,
    pub pose: [f64; 3],
    offset_s: f64,
    next_s: f64,
    phase_s: f64,
    frames: u32,
    goal: Option<([f64; 3], [f64; 3], f64, f64)>,
    vacated: Option<([f64; 2], f64)>,
    sway: Vec<f64>,
    tracks: BTreeMap<usize, (u32, f64)>,
    /// Until when who was with others is in doubt.
    doubt_until: BTreeMap<usize, f64>,
    next_track: u32,
    /// Shadows and ghosts: where, until when, under which number.
    clutter: Vec<([f64; 2], f64, u32)>,
    /// People in two pieces: who, until when, numbers.
    split: BTreeMap<usize, (f64, u32)>,
    /// People it has lost sight of, until when.
    lost: BTreeMap<usize, f64>,
    /// Pairs of people, and which is further left in its picture.
    order: BTreeMap<(usize, usize), bool>,
}

#[derive(Debug, Clone)]
pub struct PersonTruth {
    pub position: [f64; 2],
    pub height_m: f64,
    /// Robots that see it (alone or merged) at present.
    pub seen_by: Vec<usize>,
    velocity: [f64; 2],
    goal: [f64; 2],
    rest_until_s: f64,
}

impl PersonTruth {
    pub fn speed(&self) -> f64 {
        self.velocity[0].hypot(self.velocity[1])
    }
}

#[derive(Debug)]
pub struct World {
    settings: Settings,
    rng: ChaCha8Rng,
    pub time_s: f64,
    pub robots: Vec<RobotTruth>,
    pub people: Vec<PersonTruth>,
    bias: BTreeMap<(usize, usize, u8), f64>,
    common_bias: f64,
    history: Vec<(f64, Vec<[f64; 3]>, Vec<PersonTruth>)>,
    costs: Option<Vec<f64>>,
    /// What the robots said, and when, where that is kept.
    said: Option<Vec<(f64, RobotId, Observation)>>,
    /// What the leader told people.
    pub notices: Vec<String>,
    /// What it said of better places, and when.
    pub guidance: Vec<(f64, protocol::message::Guidance)>,
    /// Of each neighbour that a robot was told of: which robot, when, how far he is from anybody (m), whether a track was named.
    pub neighbours: Vec<(usize, f64, f64, bool)>,
    /// When the robot that went where it was told stands there.
    pub arrived_s: Option<f64>,
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    Normal::new(0.0, sigma).unwrap().sample(rng)
}

fn wrapped(a: f64) -> f64 {
    a.sin().atan2(a.cos())
}

fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

impl World {
    pub fn new(settings: Settings, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut poses: Vec<[f64; 3]> = settings.places.clone().unwrap_or_default();
        while poses.len() < settings.robots {
            let p = [
                rng.random_range(1.3..ROOM_M[0] - 1.3),
                rng.random_range(1.3..ROOM_M[1] - 1.3),
                rng.random_range(-3.1..3.1),
            ];
            if poses.iter().all(|q| apart([p[0], p[1]], [q[0], q[1]]) > 1.5) {
                poses.push(p);
            }
        }
        let mut robots = Vec::new();
        for (k, pose) in poses.iter().enumerate() {
            let phase_s = rng.random_range(0.0..0.1);
            let goal = settings.drives.iter().find(|d| d.0 == k).map(|&(_, from_s, to_s)| {
                let goal = loop {
                    if let Some(given) = settings.goals.get(&k) {
                        break *given;
                    }
                    let a: f64 = rng.random_range(-3.1..3.1);
                    let g = [pose[0] + 2.0 * a.cos(), pose[1] + 2.0 * a.sin()];
                    let inside = (1.0..ROOM_M[0] - 1.0).contains(&g[0]) && (1.0..ROOM_M[1] - 1.0).contains(&g[1]);
                    let free = poses.iter().enumerate().all(|(j, q)| {
                        j == k
                            || (0..=10).all(|s| {
                                let f = f64::from(s) / 10.0;
                                let at = [pose[0] + f * (g[0] - pose[0]), pose[1] + f * (g[1] - pose[1])];
                                apart(at, [q[0], q[1]]) > 0.8
                            })
                    });
                    if inside && free {
                        break [g[0], g[1], pose[2] + std::f64::consts::FRAC_PI_2];
                    }
                };
                (*pose, goal, from_s, to_s)
            });
            robots.push(RobotTruth {
                id: settings.names[k].parse().unwrap(),
                pose: *pose,
                offset_s: rng.random_range(-0.02..0.02),
                next_s: phase_s,
                phase_s,
                frames: 0,
                goal,
                vacated: None,
                sway: vec![0.0; settings.people],
                tracks: BTreeMap::new(),
                doubt_until: BTreeMap::new(),
                next_track: 0,
                clutter: Vec::new(),
                split: BTreeMap::new(),
                lost: BTreeMap::new(),
                order: BTreeMap::new(),
            });
        }
        let common_bias = normal(&mut rng, settings.common_bias_deg.to_radians());
        let mut world = Self {
            rng,
            time_s: 0.0,
            robots,
            people: Vec::new(),
            bias: BTreeMap::new(),
            common_bias,
            history: Vec::new(),
            costs: None,
            said: None,
            notices: Vec::new(),
            guidance: Vec::new(),
            neighbours: Vec::new(),
            arrived_s: None,
            settings,
        };
        for _ in 0..world.settings.people {
            let position = world.free_place(None);
            let goal = world.free_place(Some(position));
            let height_m = world.rng.random_range(1.55..1.9);
            world.people.push(PersonTruth {
                position,
                height_m,
                seen_by: Vec::new(),
                velocity: [0.0; 2],
                goal,
                rest_until_s: 0.0,
            });
        }
        world
    }

    /// A place to walk to, not through a wall.
    fn free_place(&mut self, from: Option<[f64; 2]>) -> [f64; 2] {
        loop {
            let p = [self.rng.random_range(0.6..ROOM_M[0] - 0.6), self.rng.random_range(0.6..ROOM_M[1] - 0.6)];
            let walled = from.is_some_and(|from| self.is_between(from, p));
            if !walled && self.robots.iter().all(|r| apart(p, [r.pose[0], r.pose[1]]) > 0.9) {
                return p;
            }
        }
    }

    /// Poses and people at a true time in the recent past.
    pub fn truth_at(&self, time_s: f64) -> (&[[f64; 3]], &[PersonTruth]) {
        let k = self.history.partition_point(|h| h.0 < time_s).min(self.history.len() - 1);
        (&self.history[k].1, &self.history[k].2)
    }

    /// Whether a wall is between two places.
    pub fn is_between(&self, one: [f64; 2], other: [f64; 2]) -> bool {
        let shut = self.settings.wall.filter(|(_, opens_s)| self.time_s < *opens_s);
        shut.is_some_and(|(x_m, _)| (one[0] < x_m) != (other[0] < x_m))
    }

    pub fn drives(&self, robot: usize) -> bool {
        self.settings.drives.iter().any(|d| d.0 == robot)
    }

    pub fn moves(&self, robot: usize) -> bool {
        self.robots[robot].goal.is_some_and(|(_, _, from_s, to_s)| (from_s..to_s).contains(&self.time_s))
    }

    /// Runs the leader; seconds that each observation took.
    pub fn run_timed(&mut self, leader: &mut Leader) -> Vec<f64> {
        self.costs = Some(Vec::new());
        self.run(leader, |_, _| {});
        self.costs.take().unwrap_or_default()
    }

    /// Runs the leader; what the robots said, and when.
    pub fn run_recorded(&mut self, leader: &mut Leader) -> Vec<(f64, RobotId, Observation)> {
        self.said = Some(Vec::new());
        self.run(leader, |_, _| {});
        self.said.take().unwrap_or_default()
    }

    /// Runs the leader through the whole time; `look` sees the world and each map.
    pub fn run(&mut self, leader: &mut Leader, mut look: impl FnMut(&World, &TeamMap)) {
        self.run_many(std::slice::from_mut(leader), |_, _| true, |world, _, map| look(world, map));
    }

    /// Runs several leaders, all of which hear all robots and each other; `lives` says who works when. `look` sees the world
    /// and each map with the number of who made it.
    pub fn run_many(
        &mut self,
        leaders: &mut [Leader],
        lives: impl Fn(f64, usize) -> bool,
        mut look: impl FnMut(&World, usize, &TeamMap),
    ) {
        let mut post: Vec<(f64, Option<usize>, Input)> = Vec::new();
        for r in &self.robots {
            post.push((0.0, None, Input::RobotAlive(r.id)));
            post.push((0.01, None, Input::Announcement(announcement(r.id))));
        }
        if let Some((k, at_s)) = self.settings.corrected {
            let robot = self.robots[k].id;
            post.push((at_s - RESTART_S, None, Input::RobotGone(robot)));
            post.push((at_s, None, Input::RobotAlive(robot)));
            post.push((at_s + 0.01, None, Input::Announcement(Announcement { epoch: 2, ..announcement(robot) })));
        }
        let mut outputs = Vec::new();
        let mut last = None;
        let mut lived: Vec<bool> = (0..leaders.len()).map(|k| lives(0.0, k)).collect();
        while self.time_s < self.settings.duration_s {
            self.time_s += STEP_S;
            self.step();
            for k in 0..self.robots.len() {
                if self.time_s >= self.robots[k].next_s {
                    let observation = self.observe(k);
                    let restarts = |(r, at_s)| r == k && (at_s - RESTART_S..at_s + 0.05).contains(&self.time_s);
                    if self.settings.corrected.is_some_and(restarts) {
                        continue;
                    }
                    if let Some(said) = &mut self.said {
                        said.push((self.time_s, self.robots[k].id, observation.clone()));
                    }
                    let late_s = self.rng.random_range(0.005..0.03);
                    post.push((self.time_s + late_s, None, Input::Observation(self.robots[k].id, observation)));
                }
            }
            let now_s = self.time_s;
            let mut due: Vec<(f64, Option<usize>, Input)> = Vec::new();
            post.retain(|(at_s, to, input)| {
                if *at_s <= now_s {
                    due.push((*at_s, *to, input.clone()));
                }
                *at_s > now_s
            });
            due.sort_by(|a, b| a.0.total_cmp(&b.0));
            for me in 0..leaders.len() {
                let works = lives(now_s, me);
                if lived[me] && !works {
                    let gone = leaders[me].id();
                    post.extend((0..leaders.len()).map(|to| (now_s + 0.02, Some(to), Input::LeaderGone(gone))));
                }
                if !lived[me] && works {
                    // What is kept for late joiners.
                    for r in &self.robots {
                        post.push((now_s, Some(me), Input::RobotAlive(r.id)));
                        post.push((now_s, Some(me), Input::Announcement(announcement(r.id))));
                    }
                }
                lived[me] = works;
                if !works {
                    continue;
                }
                let mut mine: Vec<(f64, Input)> = due
                    .iter()
                    .filter(|(_, to, _)| to.is_none_or(|to| to == me))
                    .map(|(at_s, _, input)| (*at_s, input.clone()))
                    .collect();
                if leaders[me].next_deadline().is_some_and(|d| d <= clock(now_s)) {
                    mine.push((now_s, Input::Deadline));
                }
                for (at_s, input) in mine {
                    let observation = matches!(input, Input::Observation(..));
                    let begin = std::time::Instant::now();
                    leaders[me].handle(clock(at_s), input, &mut outputs);
                    if let Some(costs) = self.costs.as_mut().filter(|_| observation) {
                        costs.push(begin.elapsed().as_secs_f64());
                    }
                }
                let everybody = || (0..leaders.len()).filter(move |to| *to != me);
                for output in outputs.drain(..) {
                    match output {
                        Output::Map(map) => {
                            look(self, me, &map);
                            last = Some(map.clone());
                            post.extend(everybody().map(|to| (now_s + 0.001, Some(to), Input::Map(map.clone()))));
                        }
                        Output::Candidacy(word) => {
                            post.extend(everybody().map(|to| (now_s + 0.001, Some(to), Input::Candidacy(word))));
                        }
                        Output::ClockProbe(robot, probe) => {
                            let k = self.robots.iter().position(|r| r.id == robot).unwrap();
                            let r = &self.robots[k];
                            let out_s = self.rng.random_range(0.0005..0.004);
                            let back_s = self.rng.random_range(0.0005..0.004);
                            let reply = ClockReply {
                                probe_sent: probe.sent,
                                received: probe.sent.offset_by_secs(out_s + r.offset_s),
                                replied: probe.sent.offset_by_secs(out_s + r.offset_s + 1e-4),
                                epoch: self.session(k),
                            };
                            let sent_s = probe.sent.seconds_since(clock(0.0));
                            let arrives_s = sent_s + out_s + 1e-4 + back_s;
                            post.push((arrives_s, Some(me), Input::ClockReply(robot, reply)));
                        }
                        Output::Guidance(guidance) => {
                            let listens = self.settings.follows_from_s.is_some_and(|t| now_s > t);
                            if listens && self.arrived_s.is_none() {
                                self.follow(&guidance, last.as_ref());
                            }
                            self.guidance.push((now_s, guidance));
                        }
                        Output::Surroundings(said) => self.compare_neighbours(now_s, &said),
                        Output::Reign(_) | Output::Renew | Output::Alarm(_) => {}
                        Output::Notice(text) => {
                            println!("leader {me} at {now_s:.2}: {text}");
                            self.notices.push(text);
                        }
                    }
                }
            }
        }
    }

    /// What a robot is told against where people are by its own clock, in its own frame.
    fn compare_neighbours(&mut self, now_s: f64, said: &protocol::message::Surroundings) {
        let Some(k) = self.robots.iter().position(|r| r.id == said.robot) else { return };
        let time_s = said.at.seconds_since(clock(0.0)) - self.robots[k].offset_s;
        let (poses, people) = self.truth_at(time_s);
        let [x, y, heading] = poses[k];
        let told = said.people.iter().map(|n| {
            let (sin, cos) = (heading + n.bearing.rad()).sin_cos();
            let at = [x + n.range.m() * cos, y + n.range.m() * sin];
            let away = |p: &PersonTruth| (p.position[0] - at[0]).hypot(p.position[1] - at[1]);
            (k, now_s, people.iter().map(away).fold(f64::MAX, f64::min), n.track.is_some())
        });
        let told: Vec<_> = told.collect();
        self.neighbours.extend(told);
    }

    /// The robot goes to its goal by what the map says of its own pose.
    fn follow(&mut self, guidance: &protocol::message::Guidance, map: Option<&TeamMap>) {
        let believed = map.and_then(|m| m.robots.iter().find(|r| r.id == guidance.robot)?.team_from_body);
        let (Some(believed), Some(k)) = (believed, self.robots.iter().position(|r| r.id == guidance.robot)) else {
            return;
        };
        let step = believed.inverse() * guidance.team_from_goal;
        let [x, y, heading] = self.robots[k].pose;
        let (s, c) = heading.sin_cos();
        let goal = [x + c * step.x_m - s * step.y_m, y + s * step.x_m + c * step.y_m, heading + step.heading_rad];
        let end_s = self.time_s + step.position().norm() / 0.5 + 1.0;
        self.robots[k].goal = Some(([x, y, heading], goal, self.time_s, end_s));
        self.arrived_s = Some(end_s);
    }

    fn step(&mut self) {
        let t = self.time_s;
        for r in &mut self.robots {
            if let Some((from, to, from_s, to_s)) = r.goal {
                let f = ((t - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
                let f = f * f * (3.0 - 2.0 * f);
                for k in 0..3 {
                    r.pose[k] = from[k] + f * (to[k] - from[k]);
                }
                if t > from_s && r.vacated.is_none() {
                    r.vacated = Some(([from[0], from[1]], from_s));
                }
            }
            let keep = (-STEP_S / self.settings.sway_memory_s).exp();
            for s in &mut r.sway {
                *s = keep * *s + normal(&mut self.rng, self.settings.sway_m * (1.0 - keep * keep).sqrt());
            }
        }
        for k in 0..self.people.len() {
            let (position, goal) = (self.people[k].position, self.people[k].goal);
            let distance = apart(position, goal);
            if t >= self.people[k].rest_until_s && distance < 0.2 {
                let rest_s = if self.rng.random_range(0.0..1.0) < 0.4 { 10.0 } else { 0.5 };
                // Sometimes where somebody else is going: they meet.
                let other = self.rng.random_range(0..self.people.len());
                let meet = self.rng.random_range(0.0..1.0) < 0.3 && other != k;
                let next = if meet {
                    let o = self.people[other].goal;
                    [o[0] + 0.45, o[1] + 0.2]
                } else {
                    {
                        let from = self.people[k].position;
                        self.free_place(Some(from))
                    }
                };
                let p = &mut self.people[k];
                p.rest_until_s = t + rest_s;
                p.goal = next;
            }
            let mut wish = [0.0, 0.0];
            if t >= self.people[k].rest_until_s {
                let speed = 1.2f64.min(1.5 * distance + 0.1);
                wish = [(goal[0] - position[0]) / distance * speed, (goal[1] - position[1]) / distance * speed];
                let bodies = self.robots.iter().map(|r| ([r.pose[0], r.pose[1]], 0.9));
                let others = self.people.iter().enumerate().filter(|(o, _)| *o != k).map(|(_, o)| (o.position, 0.6));
                for (body, reach) in bodies.chain(others) {
                    let d = apart(position, body).max(0.05);
                    if d < reach {
                        let push = 2.5 * (reach - d) / d;
                        let side = [-(position[1] - body[1]), position[0] - body[0]];
                        wish[0] += push * (position[0] - body[0] + 0.5 * side[0]);
                        wish[1] += push * (position[1] - body[1] + 0.5 * side[1]);
                    }
                }
            }
            let p = &mut self.people[k];
            for (axis, wished) in wish.iter().enumerate() {
                let a = ((wished - p.velocity[axis]) / 0.3).clamp(-3.0, 3.0);
                p.velocity[axis] += a * STEP_S;
                p.position[axis] += p.velocity[axis] * STEP_S;
            }
        }
        let poses = self.robots.iter().map(|r| r.pose).collect();
        let people = self.people.clone();
        self.history.push((t, poses, people));
        if self.history.len() > 400 {
            self.history.drain(..200);
        }
    }

    fn pair_bias(&mut self, observer: usize, peer: usize, part: u8) -> f64 {
        // A new pose has new errors: one draw for before, during and after the drive.
        let sigma = self.settings.pair_bias_deg.to_radians();
        let epoch = |w: &Self, r: usize| match w.robots[r].goal {
            Some((_, _, from_s, to_s)) => u8::from(w.time_s > from_s) + u8::from(w.time_s > to_s),
            None => 0,
        };
        let key = (observer, peer, part + 4 * epoch(self, observer) + 16 * epoch(self, peer));
        let rng = &mut self.rng;
        *self.bias.entry(key).or_insert_with(|| normal(rng, sigma))
    }

    /// What a fault gives for a robot, else `none`.
    fn fault(&self, none: f64, of: impl Fn(&Fault) -> Option<f64>) -> f64 {
        self.settings.faults.iter().find_map(of).unwrap_or(none)
    }

    fn observe(&mut self, k: usize) -> Observation {
        for fault in self.settings.faults.clone() {
            if let Fault::Carried(who, at_s, pose) = fault
                && self.time_s >= at_s
            {
                self.robots[who].pose = pose;
            }
        }
        let late_s = self.fault(0.0, |f| if let Fault::Late(r, s) = f { (*r == k).then_some(*s) } else { None });
        let r = &mut self.robots[k];
        let (sequence, t) = (r.frames, self.time_s);
        r.frames += 1;
        r.next_s = r.phase_s + 0.1 * f64::from(r.frames) + self.rng.random_range(-0.01..0.01);
        let capture = clock(t + self.robots[k].offset_s + late_s);
        let claims = |f: &Fault| matches!(f, Fault::Claims(r, from, to) if *r == k && (*from..*to).contains(&t));
        // The robot notices late, both ways.
        let motion = match self.robots[k].goal {
            _ if self.settings.faults.iter().any(claims) => Motion::Moving,
            Some((_, _, from_s, to_s)) if t > from_s + self.settings.notices_after_s && t < to_s + 0.2 => {
                Motion::Moving
            }
            _ if sequence < 3 => Motion::Unknown,
            _ => Motion::Standing,
        };
        let ready_s = match self.robots[k].goal {
            Some((_, _, _, to_s)) if t > to_s => to_s + 1.2,
            _ => 1.5,
        };
        let sightings = self.sightings(k);
        let tracks = if motion == Motion::Standing && t > ready_s { self.tracks(k) } else { self.lose_tracks(k) };
        let epoch = self.session(k);
        Observation { epoch, sequence, capture, motion, odometry: None, stages: Stages::ALL, sightings, tracks }
    }

    /// Number of the session of a robot's program.
    fn session(&self, k: usize) -> u64 {
        let is_new = |(r, at_s)| r == k && self.time_s >= at_s;
        if self.settings.corrected.is_some_and(is_new) { 2 } else { 1 }
    }

    fn lose_tracks(&mut self, k: usize) -> Vec<TrackObservation> {
        self.robots[k].tracks.clear();
        for p in &mut self.people {
            p.seen_by.retain(|r| *r != k);
        }
        Vec::new()
    }

    fn sightings(&mut self, k: usize) -> Vec<PeerSighting> {
        let me = self.robots[k].pose;
        let mut found = Vec::new();
        if self.settings.faults.iter().any(|f| matches!(f, Fault::Blind(r) if *r == k)) {
            return found;
        }
        let named = self.settings.faults.iter().any(|f| matches!(f, Fault::Called(..)));
        for j in (0..self.robots.len()).filter(|j| *j != k) {
            let backwards =
                self.settings.faults.iter().any(|f| matches!(f, Fault::Backwards(a, b) if (*a, *b) == (k, j)));
            let thick = self.fault(1.0, |f| match f {
                Fault::Thick(r, x) => (*r == j && self.session(j) == 1).then_some(*x),
                _ => None,
            });
            let called = self.settings.faults.iter().find_map(|f| match f {
                Fault::Called(r, name) if *r == j => Some(*name),
                _ => None,
            });
            let other = self.robots[j].pose;
            let now_s = self.time_s;
            let apart_from =
                |f: &Fault| matches!(f, Fault::Apart(a, b, s) if now_s > *s && [(k, j), (j, k)].contains(&(*a, *b)));
            if self.is_between([me[0], me[1]], [other[0], other[1]]) || self.settings.faults.iter().any(apart_from) {
                continue;
            }
            let d = apart([me[0], me[1]], [other[0], other[1]]);
            let b = wrapped((other[1] - me[1]).atan2(other[0] - me[0]) - me[2]);
            let hidden = self.people.iter().any(|p| {
                let dp = apart([me[0], me[1]], p.position);
                let bp = wrapped((p.position[1] - me[1]).atan2(p.position[0] - me[0]) - me[2]);
                dp < d && wrapped(bp - b).abs() < (HALF_PERSON_M / dp + 0.2 / d)
            });
            if hidden {
                continue;
            }
            let edge = self.settings.edge_sigma_deg.to_radians();
            let left = normal(&mut self.rng, edge);
            let right = normal(&mut self.rng, edge);
            let shift = self.pair_bias(k, j, 0);
            let wider = self.common_bias + self.pair_bias(k, j, 1);
            let width = 2.0 * (0.2 * thick / d).asin() + left - right + wider;
            let range = 0.2 / (0.5 * width).sin();
            let range_sigma = range * (range * range - 0.04).sqrt() / 0.4 * 2f64.sqrt() * edge;
            found.push(PeerSighting {
                marker: Marker::CYLINDER,
                robot: named.then(|| self.robots[called.unwrap_or(j)].id),
                bearing: Angle16::from_rad(
                    b + 0.5 * (left + right) + shift + if backwards { std::f64::consts::PI } else { 0.0 },
                ),
                bearing_sigma: LogSigma::from_value(edge / 2f64.sqrt()),
                range: Some(SightedRange {
                    range: Millimetres::from_m(range),
                    sigma: LogSigma::from_value(range_sigma),
                }),
                heading: None,
                confidence: Fraction8::from_value(0.9),
                features: Vec::new(),
            });
        }
        found.sort_by_key(|s| s.bearing);
        found
    }

    fn tracks(&mut self, k: usize) -> Vec<TrackObservation> {
        let t = self.time_s;
        let me = self.robots[k].pose;
        // (number: people first, then robots that move, then ghosts; bearing, range, half width, height)
        let mut things: Vec<(usize, f64, f64, f64, f64)> = Vec::new();
        let see = |p: [f64; 2]| {
            let d = apart([me[0], me[1]], p);
            (wrapped((p[1] - me[1]).atan2(p[0] - me[0]) - me[2]), d)
        };
        for (n, p) in self.people.iter().enumerate().filter(|(_, p)| !self.is_between([me[0], me[1]], p.position)) {
            let (b, d) = see(p.position);
            things.push((n, b, d, (HALF_PERSON_M / d).atan(), p.height_m));
        }
        for (j, r) in self.robots.iter().enumerate().filter(|(j, _)| *j != k) {
            if self.moves(j) && !self.is_between([me[0], me[1]], [r.pose[0], r.pose[1]]) {
                let (b, d) = see([r.pose[0], r.pose[1]]);
                things.push((100 + j, b, d, (0.2 / d).atan(), 0.6));
            }
            if let Some((place, since_s)) = r.vacated
                && t > since_s + 1.0
                && t < since_s + 8.0
            {
                let (b, d) = see(place);
                things.push((200 + j, b, d, (0.2 / d).atan(), 0.5));
            }
        }
        let mut observations = Vec::new();
        let ids: Vec<usize> = things.iter().map(|x| x.0).collect();
        self.robots[k].tracks.retain(|n, _| ids.contains(n));
        for p in &mut self.people {
            p.seen_by.retain(|r| *r != k);
        }
        self.lose_and_exchange(k, &things);
        for (n, b, d, half, height) in things.clone() {
            if self.robots[k].lost.contains_key(&n) {
                // It could be seen.
                self.people[n].seen_by.push(k);
                continue;
            }
            // Regions that touch are one.
            let mut group: Vec<usize> = vec![n];
            loop {
                let more: Vec<usize> = things
                    .iter()
                    .filter(|o| !group.contains(&o.0))
                    .filter(|o| {
                        things
                            .iter()
                            .filter(|m| group.contains(&m.0))
                            .any(|m| wrapped(m.1 - o.1).abs() < m.3 + o.3 + 0.005)
                    })
                    .map(|o| o.0)
                    .collect();
                if more.is_empty() {
                    break;
                }
                group.extend(more);
            }
            let hidden = things.iter().any(|o| o.0 != n && o.2 < d && wrapped(o.1 - b).abs() + half < o.3 + half);
            // A track begins alone; of those that were never apart one speaks for all.
            let merged = group.len() > 1;
            let established = |m: &usize| self.robots[k].tracks.get(m).is_some_and(|e| t - e.1 >= 0.35);
            if merged && !established(&n) {
                let others = group.iter().any(|m| *m != n && established(m));
                let first = things.iter().filter(|o| group.contains(&o.0)).min_by(|a, b| a.2.total_cmp(&b.2));
                if others || first.is_none_or(|f| f.0 != n) {
                    if n < 100 && !hidden && others {
                        self.people[n].seen_by.push(k);
                    }
                    continue;
                }
            }
            let speaks = group.iter().filter(|m| established(m)).count() <= 1;
            let (next, entry) = {
                let r = &mut self.robots[k];
                let next = r.next_track;
                let entry = *r.tracks.entry(n).or_insert((next, t));
                (next, entry)
            };
            if entry.0 == next {
                self.robots[k].next_track += 1;
            }
            if t - entry.1 < 0.35 {
                continue;
            }
            if n < 100 && !hidden {
                self.people[n].seen_by.push(k);
            }
            let white = self.settings.white_deg.to_radians();
            let noisy = self.fault(1.0, |f| if let Fault::Noisy(r, x) = f { (*r == k).then_some(*x) } else { None });
            let turned = self.fault(0.0, |f| if let Fault::Turned(r, x) = f { (*r == k).then_some(*x) } else { None });
            let sway = if n < 100 { self.robots[k].sway[n] / d } else { 0.0 };
            let mut sigma = white.hypot(self.settings.sway_m / d);
            let extra = (noisy * noisy - 1.0).sqrt() * sigma;
            let mut bearing = b + sway + normal(&mut self.rng, white.hypot(extra)) + turned.to_radians();
            let mut width = 2.0 * half;
            if merged && !speaks && !self.settings.regions {
                // Taken apart as well as it goes; the error lasts.
                sigma = sigma.hypot(0.4 * half);
                bearing += 0.4 * half * self.robots[k].sway.get(n).map_or(0.0, |s| s / self.settings.sway_m);
            } else if merged {
                let offsets = things
                    .iter()
                    .filter(|o| group.contains(&o.0))
                    .flat_map(|o| [wrapped(o.1 - b) - o.3, wrapped(o.1 - b) + o.3]);
                let (low, high) = offsets.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
                bearing = b + 0.5 * (low + high);
                width = high - low;
                sigma = sigma.max(0.3 * width);
            }
            if self.settings.outliers > 0.0 && self.rng.random_range(0.0..1.0) < self.settings.outliers {
                bearing += normal(&mut self.rng, half);
            }
            // The same for a track's life, without a memory: from its number.
            let stated =
                (self.settings.sigma_spread * f64::from(entry.0 * 7 % 5) - 2.0 * self.settings.sigma_spread).exp();
            let (bottom, top) = ((-15f64).to_radians(), 20f64.to_radians());
            let low = (-0.6 / d).atan() + normal(&mut self.rng, 0.005);
            let high = ((height - 0.6) / d).atan() + normal(&mut self.rng, 0.005);
            let end = |cut: bool| if cut { ElevationEnd::Cut } else { ElevationEnd::Seen };
            if merged {
                self.robots[k].doubt_until.insert(n, t + self.settings.doubt_s);
            }
            let doubtful = self.robots[k].doubt_until.get(&n).is_some_and(|until| t < *until);
            observations.push(TrackObservation {
                track: TrackId(entry.0),
                state: if merged && !speaks { TrackState::Merged } else { TrackState::Visible },
                bearing: Angle16::from_rad(bearing),
                bearing_sigma: LogSigma::from_value(sigma * stated),
                elevation: [Angle16::from_rad(low.max(bottom)), Angle16::from_rad(high.min(top))],
                elevation_sigma: LogSigma::from_value(0.005),
                ends: [end(low < bottom), end(high > top)],
                width: Angle16::from_rad(width.min(3.0)),
                range: None,
                class: ObjectClass::Unknown,
                confidence: Fraction8::from_value(0.9),
                doubtful,
                appearance: None,
            });
        }
        self.clutter(k, &mut observations);
        observations
    }

    /// Robot `k` loses people and exchanges numbers. `things`: number, bearing, range, half width, height.
    fn lose_and_exchange(&mut self, k: usize, things: &[(usize, f64, f64, f64, f64)]) {
        let t = self.time_s;
        let settings = self.settings.clone();
        self.robots[k].lost.retain(|_, until| *until > t);
        let people: Vec<(usize, f64, f64)> = things.iter().filter(|x| x.0 < 100).map(|x| (x.0, x.1, x.3)).collect();
        for (n, bearing, half) in &people {
            if settings.losses_per_s > 0.0
                && !self.robots[k].lost.contains_key(n)
                && self.rng.random_range(0.0..1.0) < 0.1 * settings.losses_per_s
            {
                let until = t + self.rng.random_range(1.0..4.0);
                self.robots[k].lost.insert(*n, until);
                self.robots[k].tracks.remove(n);
            }
            for (m, other, other_half) in people.iter().filter(|p| p.0 > *n) {
                let apart = wrapped(bearing - other);
                let passed =
                    self.robots[k].order.insert((*n, *m), apart > 0.0).is_some_and(|left| left != (apart > 0.0));
                if !passed || apart.abs() > half + other_half || settings.exchanges == 0.0 {
                    continue;
                }
                let tracks = &mut self.robots[k].tracks;
                if let (Some(x), Some(y)) = (tracks.get(n).copied(), tracks.get(m).copied())
                    && self.rng.random_range(0.0..1.0) < settings.exchanges
                {
                    tracks.insert(*n, y);
                    tracks.insert(*m, x);
                }
            }
        }
    }

    /// What is nobody, and people in two pieces.
    fn clutter(&mut self, k: usize, observations: &mut Vec<TrackObservation>) {
        let t = self.time_s;
        let me = self.robots[k].pose;
        self.robots[k].clutter.retain(|c| c.1 > t);
        while self.robots[k].clutter.len() < self.settings.clutter {
            let place = [self.rng.random_range(0.5..ROOM_M[0] - 0.5), self.rng.random_range(0.5..ROOM_M[1] - 0.5)];
            let until = t + self.rng.random_range(0.3..8.0);
            let number = self.robots[k].next_track;
            self.robots[k].next_track += 1;
            self.robots[k].clutter.push((place, until, number));
        }
        let mut extra = Vec::new();
        for &(place, _, number) in &self.robots[k].clutter.clone() {
            let d = apart([me[0], me[1]], place).max(0.5);
            let b = wrapped((place[1] - me[1]).atan2(place[0] - me[0]) - me[2]);
            let low = (-0.6 / d).atan().max((-15f64).to_radians());
            let high = low + self.rng.random_range(0.02..0.15);
            extra.push((number, b, low, high, 0.4 / d, d));
        }
        let near: Vec<usize> = (0..self.people.len()).collect();
        for n in near {
            let position = self.people[n].position;
            let d = apart([me[0], me[1]], position);
            let alone = self.people[n].seen_by.contains(&k);
            if let Some((until, _)) = self.robots[k].split.get(&n)
                && *until < t
            {
                self.robots[k].split.remove(&n);
            }
            let share = self.settings.split;
            if share > 0.0
                && alone
                && d < 2.5
                && !self.robots[k].split.contains_key(&n)
                && self.rng.random_range(0.0..1.0) < share * 0.1
            {
                let number = self.robots[k].next_track;
                self.robots[k].next_track += 1;
                let until = t + self.rng.random_range(0.3..1.7);
                self.robots[k].split.insert(n, (until, number));
            }
            if let Some((_, number)) = self.robots[k].split.get(&n) {
                let b = wrapped((position[1] - me[1]).atan2(position[0] - me[0]) - me[2]);
                let high = ((1.2 - 0.6) / d).atan().min(20f64.to_radians());
                extra.push((*number, b + 0.13 / d, (-15f64).to_radians(), high, 0.2 / d, d));
            }
        }
        for (number, bearing, low, high, width, d) in extra {
            observations.push(TrackObservation {
                track: TrackId(number),
                state: TrackState::Visible,
                bearing: Angle16::from_rad(bearing + normal(&mut self.rng, 0.004)),
                bearing_sigma: LogSigma::from_value(NOBODY_SIGMA_M / d),
                elevation: [Angle16::from_rad(low), Angle16::from_rad(high)],
                elevation_sigma: LogSigma::from_value(0.005),
                ends: [ElevationEnd::Seen, ElevationEnd::Seen],
                width: Angle16::from_rad(width),
                range: None,
                class: ObjectClass::Unknown,
                confidence: Fraction8::from_value(0.9),
                doubtful: false,
                appearance: None,
            });
        }
    }
}

/// How long a program that is started anew says nothing, seconds.
const RESTART_S: f64 = 1.5;

pub fn clock(time_s: f64) -> Timestamp {
    Timestamp::from_secs_f64(START_S).offset_by_secs(time_s)
}

pub fn announcement(robot: RobotId) -> Announcement {
    Announcement {
        robot,
        epoch: 1,
        host: "world".into(),
        version: "0".into(),
        marker: Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None },
        camera: CameraSummary {
            model: "pal".into(),
            height_m: 0.6,
            height_sigma_m: 0.002,
            tilt_sigma_rad: 0.002,
            elevation_rad: [(-15f64).to_radians(), 20f64.to_radians()],
            frame_rate_hz: 10.0,
        },
    }
}
