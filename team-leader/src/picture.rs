//! The team map as a picture for people: robots with their headings, targets with trails, and how sure the map is of each.
//!
//! Ellipses hold the truth with 95 % probability if the covariances are honest (χ² with two degrees of freedom: 2.45 σ). A
//! robot's is of centimetres and would vanish under its symbol, so it is drawn enlarged by [`ROBOT_ELLIPSE_SCALE`], thin.
//! Where the truth is known, as in a simulation, it is laid over as outlines.

mod canvas;
mod view;

use std::collections::{BTreeMap, VecDeque};

use image::{Rgb, RgbImage};
use nalgebra::{DMatrix, Matrix2, Vector2};
use protocol::frames::Pose2;
use protocol::id::TargetId;
use protocol::message::{MapRobot, MapStatus, MapTarget, Presence, TeamMap};
use protocol::time::Timestamp;

use canvas::Canvas;
use view::View;

/// √5.99: the radius, in σ, of the ellipse that holds 95 % of a plane normal distribution.
pub const ELLIPSE_SIGMAS: f64 = 2.447;
/// Robots' ellipses are drawn so many times their size.
pub const ROBOT_ELLIPSE_SCALE: f64 = 5.0;
/// How much of a target's past is drawn, seconds.
pub const TRAIL_S: f64 = 5.0;
/// Most components that are drawn, and the rows above their panels.
const MAX_PANELS: usize = 16;
const CAPTION_PX: u32 = 48;
/// Most points of a trail.
const MAX_TRAIL_POINTS: usize = 512;
/// Radius at which robots are drawn, metres.
const ROBOT_RADIUS_M: f64 = 0.2;
/// Radius at which people are drawn, metres.
const PERSON_RADIUS_M: f64 = 0.12;

const PAPER: Rgb<u8> = Rgb([250, 250, 247]);
const GRID: Rgb<u8> = Rgb([226, 226, 222]);
const INK: Rgb<u8> = Rgb([40, 40, 44]);
const FAINT: Rgb<u8> = Rgb([150, 150, 150]);
const FURNITURE: Rgb<u8> = Rgb([205, 198, 186]);
const EDGE: Rgb<u8> = Rgb([96, 84, 70]);
const ROBOT: Rgb<u8> = Rgb([38, 84, 160]);
const TRUTH: Rgb<u8> = Rgb([20, 140, 70]);
const TARGETS: [Rgb<u8>; 6] = [
    Rgb([200, 60, 40]),
    Rgb([150, 70, 160]),
    Rgb([205, 130, 20]),
    Rgb([30, 140, 160]),
    Rgb([120, 110, 30]),
    Rgb([190, 60, 120]),
];

/// What is laid over the map, in the team frame. All parts may be empty.
#[derive(Debug, Clone, Default)]
pub struct Overlay {
    /// Closed outlines in metres: walls, furniture.
    pub outlines: Vec<Vec<[f64; 2]>>,
    /// Where the robots truly are.
    pub robots: Vec<(String, Pose2)>,
    /// Where the people truly are.
    pub people: Vec<(String, [f64; 2])>,
    /// Upright edges of the map: where, and their covariance.
    pub edges: Vec<([f64; 2], Matrix2<f64>)>,
}

/// The recent past of all targets.
#[derive(Debug, Clone, Default)]
pub struct Trails {
    points: BTreeMap<TargetId, VecDeque<(Timestamp, [f64; 2])>>,
}

impl Trails {
    /// Takes a map in; forgets what is older than [`TRAIL_S`].
    pub fn record(&mut self, map: &TeamMap) {
        for target in &map.targets {
            let trail = self.points.entry(target.id).or_default();
            trail.push_back((map.stamp, [target.position_m[0], target.position_m[1]]));
            if trail.len() > MAX_TRAIL_POINTS {
                trail.pop_front();
            }
        }
        self.points.retain(|_, trail| {
            while trail.front().is_some_and(|(at, _)| map.stamp.seconds_since(*at) > TRAIL_S) {
                trail.pop_front();
            }
            !trail.is_empty()
        });
    }
}

/// Draws a map `width_px` wide and `height_px` high (each 200 … 4000, else clamped). The view holds everything there is. Robots
/// that nothing ties together are in panels of their own, each in its frame; the overlay belongs to the first.
pub fn draw(map: &TeamMap, trails: &Trails, overlay: Option<&Overlay>, width_px: u32, height_px: u32) -> RgbImage {
    let (width, height) = (width_px.clamp(200, 4000), height_px.clamp(200, 4000));
    let mut components = map.components();
    if components.len() < 2 {
        let component = components.first().copied().unwrap_or(0);
        let (mut canvas, view) = panel(map, trails, overlay, component, [width, height]);
        caption(&mut canvas, map);
        legend(&mut canvas, &view, overlay);
        return canvas.into_image();
    }
    components.truncate(MAX_PANELS);
    let mut canvas = Canvas::new(width, height, PAPER);
    caption(&mut canvas, map);
    let mut whole = canvas.into_image();
    let columns = (components.len() as f64).sqrt().ceil() as u32;
    let rows = (components.len() as u32).div_ceil(columns);
    let size = [width / columns, height.saturating_sub(CAPTION_PX) / rows];
    for (k, component) in (0..).zip(components) {
        let overlay = overlay.filter(|_| component == 0);
        let (mut canvas, view) = panel(map, trails, overlay, component, size);
        let [w, h] = size.map(f64::from);
        canvas.polyline(&[[0.0, h], [0.0, 0.0], [w, 0.0]], 1.0, FAINT, 1.0);
        let names: Vec<&str> = map.placed(component).take(8).map(|robot| robot.id.as_str()).collect();
        let title = format!("component {component}: {}", names.join(", "));
        canvas.text([12.0, 8.0], 15.0, INK, &title);
        legend(&mut canvas, &view, overlay);
        let corner = [k % columns * size[0], CAPTION_PX + k / columns * size[1]].map(i64::from);
        image::imageops::replace(&mut whole, &canvas.into_image(), corner[0], corner[1]);
    }
    whole
}

/// One component with its grid.
fn panel(
    map: &TeamMap,
    trails: &Trails,
    overlay: Option<&Overlay>,
    component: u8,
    [width, height]: [u32; 2],
) -> (Canvas, View) {
    let mut canvas = Canvas::new(width, height, PAPER);
    let view = View::holding(extent(map, overlay, component), canvas.size());
    grid(&mut canvas, &view);
    if let Some(overlay) = overlay {
        surroundings(&mut canvas, &view, overlay);
    }
    let joint = map.joint_covariance_of(component).unwrap_or_else(|| DMatrix::zeros(0, 0));
    let targets = || map.targets.iter().filter(|target| target.component == component);
    for target in targets() {
        if let Some(trail) = trails.points.get(&target.id) {
            let points: Vec<[f64; 2]> = trail.iter().map(|(_, at)| view.px(*at)).collect();
            canvas.polyline(&points, 1.5, colour(target.id), 0.55);
        }
    }
    for (k, robot) in map.placed(component).enumerate() {
        if let Some(pose) = robot.team_from_body {
            self::robot(&mut canvas, &view, robot, &pose, &block(&joint, 3 * k));
        }
    }
    for target in targets() {
        self::target(&mut canvas, &view, target, &joint);
    }
    if let Some(overlay) = overlay {
        truth(&mut canvas, &view, overlay);
    }
    (canvas, view)
}

fn extent(map: &TeamMap, overlay: Option<&Overlay>, component: u8) -> Vec<[f64; 2]> {
    let targets = map.targets.iter().filter(|target| target.component == component);
    let mut points: Vec<[f64; 2]> = targets.map(|t| [t.position_m[0], t.position_m[1]]).collect();
    points.extend(map.placed(component).filter_map(|r| r.team_from_body).map(|p| [p.x_m, p.y_m]));
    if let Some(overlay) = overlay {
        points.extend(overlay.outlines.iter().flatten());
        points.extend(overlay.people.iter().map(|(_, at)| *at));
        points.extend(overlay.robots.iter().map(|(_, pose)| [pose.x_m, pose.y_m]));
    }
    points
}

fn grid(canvas: &mut Canvas, view: &View) {
    let [low, high] = view.bounds_m();
    for x in low[0].ceil() as i64..=high[0].floor() as i64 {
        canvas.line(view.px([x as f64, low[1]]), view.px([x as f64, high[1]]), 1.0, GRID, 1.0);
    }
    for y in low[1].ceil() as i64..=high[1].floor() as i64 {
        canvas.line(view.px([low[0], y as f64]), view.px([high[0], y as f64]), 1.0, GRID, 1.0);
    }
}

fn surroundings(canvas: &mut Canvas, view: &View, overlay: &Overlay) {
    for outline in &overlay.outlines {
        let mut points: Vec<[f64; 2]> = outline.iter().map(|p| view.px(*p)).collect();
        points.extend(points.first().copied());
        canvas.polyline(&points, 2.0, FURNITURE, 1.0);
    }
    for (at, covariance) in &overlay.edges {
        ellipse(canvas, view, *at, covariance, ELLIPSE_SIGMAS, EDGE, 0.0);
        canvas.disc(view.px(*at), 2.2, EDGE, 1.0);
    }
}

fn robot(canvas: &mut Canvas, view: &View, robot: &MapRobot, pose: &Pose2, covariance: &Matrix2<f64>) {
    let ink = if robot.presence == Presence::Offline { FAINT } else { ROBOT };
    let centre = [pose.x_m, pose.y_m];
    ellipse(canvas, view, centre, covariance, ELLIPSE_SIGMAS * ROBOT_ELLIPSE_SCALE, ink, 0.0);
    canvas.disc(view.px(centre), ROBOT_RADIUS_M * view.px_per_m(), ink, 0.25);
    canvas.ring(view.px(centre), ROBOT_RADIUS_M * view.px_per_m(), 1.8, ink, 1.0);
    let ahead = pose.transform(Vector2::new(1.7 * ROBOT_RADIUS_M, 0.0));
    canvas.line(view.px(centre), view.px(ahead.into()), 2.2, ink, 1.0);
    let [x, y] = view.px(centre);
    let moving = if robot.moving { " moving" } else { "" };
    canvas.text(
        [x + 0.8 * ROBOT_RADIUS_M * view.px_per_m() + 4.0, y + 4.0],
        15.0,
        ink,
        &format!("{}{moving}", robot.id),
    );
}

fn target(canvas: &mut Canvas, view: &View, target: &MapTarget, joint: &DMatrix<f64>) {
    let ink = colour(target.id);
    let at = [target.position_m[0], target.position_m[1]];
    let covariance = target.covariance(joint).unwrap_or_default().fixed_view::<2, 2>(0, 0).into_owned();
    ellipse(canvas, view, at, &covariance, ELLIPSE_SIGMAS, ink, 0.18);
    canvas.disc(view.px(at), 4.0, ink, 1.0);
    let ahead = [at[0] + 0.5 * f64::from(target.velocity_mps[0]), at[1] + 0.5 * f64::from(target.velocity_mps[1])];
    canvas.line(view.px(at), view.px(ahead), 1.6, ink, 1.0);
    let [x, y] = view.px(at);
    let height = target.height_m.map_or(String::new(), |(h, s)| format!(" {h:.2}±{s:.2} m"));
    canvas.text([x + 7.0, y - 20.0], 15.0, ink, &format!("{}{height}", target.id));
}

fn truth(canvas: &mut Canvas, view: &View, overlay: &Overlay) {
    for (_, pose) in &overlay.robots {
        let centre = [pose.x_m, pose.y_m];
        canvas.cross(view.px(centre), 5.0, 1.4, TRUTH);
        let ahead = pose.transform(Vector2::new(1.4 * ROBOT_RADIUS_M, 0.0));
        canvas.line(view.px(centre), view.px(ahead.into()), 1.2, TRUTH, 1.0);
    }
    for (name, at) in &overlay.people {
        canvas.ring(view.px(*at), PERSON_RADIUS_M * view.px_per_m(), 1.4, TRUTH, 1.0);
        canvas.cross(view.px(*at), 4.0, 1.2, TRUTH);
        let [x, y] = view.px(*at);
        canvas.text([x - 22.0, y + 8.0], 13.0, TRUTH, name);
    }
}

fn caption(canvas: &mut Canvas, map: &TeamMap) {
    let placed = map.robots.iter().filter(|r| r.team_from_body.is_some()).count();
    let status = match map.status {
        MapStatus::Waiting => "waiting",
        MapStatus::Converged => "converged",
        MapStatus::Ambiguous => "ambiguous",
        MapStatus::Inconsistent => "inconsistent",
        MapStatus::Insufficient => "insufficient",
    };
    let title = format!(
        "map {} of {} · {status} · {placed} of {} robots placed · {} targets",
        map.sequence,
        map.leader,
        map.robots.len(),
        map.targets.len()
    );
    canvas.text([12.0, 8.0], 17.0, INK, &title);
    let explanation: String = map.explanation.chars().take(110).collect();
    canvas.text([12.0, 30.0], 13.0, FAINT, &explanation);
}

/// The scale, and what is drawn how.
fn legend(canvas: &mut Canvas, view: &View, overlay: Option<&Overlay>) {
    let [_, height] = canvas.size();
    let foot = f64::from(height) - 24.0;
    canvas.line([14.0, foot + 8.0], [14.0 + view.px_per_m(), foot + 8.0], 2.5, INK, 1.0);
    let green = if overlay.is_some() { " · green: truth" } else { "" };
    let brown = if overlay.is_some_and(|o| !o.edges.is_empty()) { " · brown dots: upright edges" } else { "" };
    let legend =
        format!("1 m · ellipses 95 % (robots' drawn ×{ROBOT_ELLIPSE_SCALE:.0}) · trails {TRAIL_S:.0} s{brown}{green}");
    canvas.text([22.0 + view.px_per_m(), foot], 13.0, INK, &legend);
}

fn ellipse(
    canvas: &mut Canvas,
    view: &View,
    centre_m: [f64; 2],
    covariance: &Matrix2<f64>,
    sigmas: f64,
    ink: Rgb<u8>,
    fill: f32,
) {
    const CORNERS: usize = 64;
    let eigen = covariance.symmetric_eigen();
    let axis = |k: usize| eigen.eigenvectors.column(k) * (sigmas * eigen.eigenvalues[k].max(0.0).sqrt());
    let (a, b) = (axis(0), axis(1));
    if !(a.norm() < 100.0 && b.norm() < 100.0) {
        return;
    }
    let points: Vec<[f64; 2]> = (0..=CORNERS)
        .map(|n| {
            let (s, c) = (n as f64 / CORNERS as f64 * std::f64::consts::TAU).sin_cos();
            let p = Vector2::from(centre_m) + a * c + b * s;
            view.px(p.into())
        })
        .collect();
    if fill > 0.0 {
        canvas.convex(&points, ink, fill);
    }
    canvas.polyline(&points, 1.3, ink, 0.9);
}

fn colour(id: TargetId) -> Rgb<u8> {
    TARGETS[id.0 as usize % TARGETS.len()]
}

fn block(joint: &DMatrix<f64>, at: usize) -> Matrix2<f64> {
    Matrix2::from_fn(|r, c| joint.get((at + r, at + c)).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests;
